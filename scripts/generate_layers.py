#!/usr/bin/env python3
"""Write the SROS 2 policy from the layers of the stages; and their table, for docs/topics.md.

    python scripts/generate_layers.py            writes config/sros2_policy.xml

A test compares the file with what this program would write. `generate_topics.py` has the table.
"""

import re
from pathlib import Path

from coded_aperture_ros.core.options import options_of, parameter_names
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stage import StageModule
from coded_aperture_ros.depth.stages import stage_modules

CHECKOUT = Path(__file__).resolve().parent.parent
POLICY = CHECKOUT / "config" / "sros2_policy.xml"
_TABLE_HEAD = """| layer | file beside `x.npy` | topic | unit | message | where there is one |
|---|---|---|---|---|---|
"""
_POLICY_LINES = re.compile(
    r"(?P<begin> *<!-- Layers of depth, generated[^\n]*-->\n)"
    r".*?(?P<end> *<!-- End of the layers\. -->)",
    re.DOTALL,
)


def layer_table() -> str:
    """Table of the layers, in Markdown."""
    rows = []
    for module in stage_modules():
        for spec in module.LAYERS:
            points = f", points `{spec.points_topic}`" if spec.points_topic else ""
            cells = (
                f"**{spec.name}**: {spec.description}",
                f"`x{spec.file_suffix}.npy`",
                f"`{spec.topic}`{points}",
                spec.unit or "0 to 1",
                spec.encoding,
                _condition(module),
            )
            rows.append(f"| {' | '.join(cells)} |\n")
    return _TABLE_HEAD + "".join(rows)


def policy(text: str) -> str:
    """Text of the SROS 2 policy, with the topics of all layers in the profile of `depth_node`."""
    topics = []
    for module in stage_modules():
        for spec in module.LAYERS:
            topics += [spec.topic, *filter(None, [spec.points_topic])]
    lines = "".join(f"            <topic>{topic}</topic>\n" for topic in topics)
    return _POLICY_LINES.sub(rf"\g<begin>{lines}\g<end>", text)


def _condition(module: StageModule) -> str:
    """Option and parameter by which a stage is wanted, for a cell of the table."""
    if module.WHEN not in options_of(DepthConfig):
        return "where it is found"
    option = "--" + module.WHEN.replace("_", "-")
    return f"`{option}`, parameter `{parameter_names(DepthConfig)[module.WHEN]}`"


def main() -> None:
    """Write the policy."""
    POLICY.write_text(policy(POLICY.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
