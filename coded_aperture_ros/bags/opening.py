"""Opening a bag as a whole, or else file by file, each as far as it can be read."""

import re
from pathlib import Path

from coded_aperture_ros.bags.complete import DAMAGE, CompleteBag, one_line
from coded_aperture_ros.bags.contents import METADATA, SUFFIXES
from coded_aperture_ros.bags.cut_mcap import CutMcap
from coded_aperture_ros.bags.cut_sqlite import CutSqlite
from coded_aperture_ros.core.errors import InputError

_CUT: dict[str, type] = {"mcap": CutMcap, "sqlite3": CutSqlite}
# A complete bag, or one file of it; the attributes are those of `Bag`.
Part = CompleteBag | CutMcap | CutSqlite


def open_parts(path: Path, files: list[Path]) -> tuple[list[Part], list[str]]:
    """Open a bag, or, if it is damaged, its files one by one.

    Parameters
    ----------
    path : Path
    files : list of Path
        Those of the bag.

    Returns
    -------
    parts : list of Part
    damage : list of str
        Descriptions of what is wrong.

    Raises
    ------
    InputError
        If nothing in the bag can be read.
    """
    damage = []
    refused = ""
    if path.is_file() or (path / METADATA).is_file():
        try:
            return [CompleteBag(path)], []
        except PermissionError as error:
            raise InputError(f"cannot read {path}: {error.strerror}") from error
        except DAMAGE as error:
            refused = one_line(error)
            if path.is_dir():
                damage.append(f"it cannot be opened as a whole ({refused})")
    else:
        damage.append(f"it has no {METADATA}, as if the recording was cut off")
    parts: list[Part] = []
    for file in sorted(files, key=_by_number):
        for kind in (CompleteBag, _CUT[SUFFIXES[file.suffix.lower()]]):
            try:
                parts.append(kind(file))
                break
            except DAMAGE as error:
                refused = f"{file.name}: {one_line(error)}"
        else:
            damage.append(f"{file.name} cannot be read")
    if not any(part.topics for part in parts):
        for part in parts:
            part.close()
        raise InputError(f"cannot read {path}: nothing in it can be read ({refused})")
    return parts, damage + [part.damage for part in parts if part.damage]


def _by_number(path: Path) -> list[int | str]:
    """Sort key for names with numbers: file 10 comes after file 9."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]
