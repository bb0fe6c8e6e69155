#!/usr/bin/env bash
# Run the tests on all processors, then those that must have the machine to themselves.
#
# Usage: scripts/run_tests.sh PYTHON fast|all [PYTEST ARGUMENTS]
#
# `fast` leaves out the tests that are marked slow. PROCESSES sets how many run side by side.
set -uo pipefail

python=$1
case $2 in
    fast) chosen="not slow and" ;;
    all) chosen="" ;;
    *) echo "usage: $0 PYTHON fast|all [PYTEST ARGUMENTS]" >&2; exit 2 ;;
esac
shift 2
processes=${PROCESSES:-$(nproc)}
files=()

# 5 is pytest's word for "no tests": arguments may choose tests of one of the two kinds only.
# In the order of their names: else files with few tests, which are long ones, would come last, on
# one processor.
"$python" -m pytest -m "$chosen not serial" -n "$processes" --dist loadfile --no-loadscope-reorder "$@"
side_by_side=$?
[[ $side_by_side == 0 || $side_by_side == 5 ]] || failed=1
# Where no tests are named, look only where there are any of this kind: importing all takes longer.
[[ $# != 0 ]] || mapfile -t files < <(grep -rlE 'mark\.serial' --include='test_*.py' test)
"$python" -m pytest -m "$chosen serial" "${files[@]}" "$@"
alone=$?
[[ $alone == 0 || $alone == 5 ]] || failed=1
if [[ $side_by_side == 5 && $alone == 5 ]]; then
    echo 'No test is chosen by these arguments.' >&2
    exit 5
fi
exit "${failed:-0}"
