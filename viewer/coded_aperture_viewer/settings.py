"""What the page can change while frames go on."""

import dataclasses
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option, options_of
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stages import stage_modules
from coded_aperture_viewer.packet import METRES, SHARES

PICTURES = ("none", "sharp", "refocused")
# Of depth and of deblurring: what the page has a control for, and the end of its slider where the
# setting has a range that nobody would want to slide through.
_CONTROLS: dict[str, dict[str, float | None]] = {
    "depth": {
        "confidence_threshold": None,
        "regularize": None,
        "smoothness": 5.0,
        "unknown": None,
        "temporal_frames": 10.0,
        "check_fit": None,
        "free_space_risk": 0.01,
        "second_surface": None,
    },
    "deblur": {"smoothness": 5.0},
    "look": {"opening_px": None},
}


@dataclasses.dataclass(frozen=True)
class LookConfig:
    """What is looked at."""

    picture: str = option("sharp", "none, all in focus, or focused anew", choices=PICTURES)
    focus_m: float = option(1.0, "Distance in focus.", unit="m", within=(1e-3, 1e6))
    opening_px: float = option(
        10.0,
        "How blurred the nearest depth is when the farthest is in focus.",
        unit="px",
        within=(0.0, 30.0),
    )
    paused: bool = option(False, "The same frame again, whenever a setting changes.")

    def __post_init__(self) -> None:
        check_options(self)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Of depth, of deblurring and of what is looked at."""

    depth: DepthConfig
    deblur: DeblurConfig
    look: LookConfig

    def changed(self, wanted: Any) -> "Settings":
        """Return other settings: `{"depth.smoothness": 2, ...}`.

        Raises
        ------
        InputError
            If there is no such setting, or a value is not allowed.
        """
        if not isinstance(wanted, dict):
            raise InputError(f"settings: expected names and values, got {wanted!r}")
        parts: dict[str, dict[str, Any]] = {}
        for name, value in wanted.items():
            part, _, field = str(name).partition(".")
            config = getattr(self, part, None) if part in _CONTROLS else None
            if config is None or field not in options_of(config):
                raise InputError(f"settings: there is no {name}")
            # JSON does not tell 1 from 1.0.
            is_float = type(options_of(config)[field][0].default) is float
            parts.setdefault(part, {})[field] = float(value) if is_float else value
        return dataclasses.replace(
            self,
            **{
                part: dataclasses.replace(getattr(self, part), **values)
                for part, values in parts.items()
            },
        )

    def as_values(self) -> dict[str, Any]:
        """Return every setting that the page shows, by the name that `changed` takes."""
        names = {part: list(fields) for part, fields in _CONTROLS.items()}
        names["look"] = list(options_of(self.look))
        return {
            f"{part}.{field}": getattr(getattr(self, part), field)
            for part, fields in names.items()
            for field in fields
        }

    def layers(self) -> list[dict[str, Any]]:
        """What the page needs to draw each layer, and the setting that switches it on."""
        most = {control["name"]: control["most"] for control in self.controls()}
        found = []
        for module in stage_modules():
            name = f"depth.{module.WHEN}"
            for spec in module.LAYERS:
                if spec.kind in (*METRES, *SHARES):
                    found.append(
                        {
                            "name": spec.name,
                            "title": spec.title,
                            "help": spec.description,
                            "in_metres": spec.kind in METRES,
                            "setting": name if name in most else None,
                            "on": most.get(name) or True,
                        }
                    )
        return found

    def controls(self) -> list[dict[str, Any]]:
        """Return what the page needs to draw a control for each setting, in their order."""
        found = []
        for part, fields in _CONTROLS.items():
            described = options_of(getattr(self, part))
            for name, largest in fields.items():
                field, one = described[name]
                found.append(
                    {
                        "name": f"{part}.{name}",
                        "kind": type(field.default).__name__,
                        "choices": one.choices,
                        "least": one.minimum,
                        "most": one.maximum if largest is None else largest,
                        "help": one.description,
                    }
                )
        return found
