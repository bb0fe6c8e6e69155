"""Settings that the page can change while frames are processed."""

import dataclasses
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option, options_of
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stages import stage_modules
from coded_aperture_viewer.packet import METRES, SHARES

PICTURES = ("none", "sharp", "refocused")
# Settings with a control on the page, by part, and the end of the slider where the whole range of
# the setting would be too long.
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
    """Settings of the picture beside the depth map."""

    picture: str = option("sharp", "none, all-in-focus, or refocused", choices=PICTURES)
    focus_m: float = option(1.0, "Distance in focus.", unit="m", within=(1e-3, 1e6))
    opening_px: float = option(
        10.0,
        "Radius of the blur of the nearest depth if the farthest is in focus.",
        unit="px",
        within=(0.0, 30.0),
    )
    paused: bool = option(False, "Process the same frame again whenever a setting changes.")

    def __post_init__(self) -> None:
        check_options(self)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings of depth, of deblurring and of the picture.

    Examples
    --------
    >>> settings = Settings(DepthConfig(), DeblurConfig(), LookConfig())
    >>> settings.changed({"look.focus_m": 2}).look.focus_m
    2.0
    """

    depth: DepthConfig
    deblur: DeblurConfig
    look: LookConfig

    def changed(self, wanted: Any) -> "Settings":
        """Settings with some values changed: `{"depth.smoothness": 2, ...}`.

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
            # JSON does not distinguish 1 and 1.0.
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
        """Values of the page's settings, by the names that `changed` takes."""
        names = {part: list(fields) for part, fields in _CONTROLS.items()}
        names["look"] = list(options_of(self.look))
        return {
            f"{part}.{field}": getattr(getattr(self, part), field)
            for part, fields in names.items()
            for field in fields
        }

    def layers(self) -> list[dict[str, Any]]:
        """For each layer that the page can draw: its texts, unit, and the setting that adds it."""
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
        """For each control, in order: name, kind, choices, range and help text of its setting."""
        found = []
        for part, fields in _CONTROLS.items():
            described = options_of(getattr(self, part))
            for name, largest in fields.items():
                field, setting = described[name]
                found.append(
                    {
                        "name": f"{part}.{name}",
                        "kind": type(field.default).__name__,
                        "choices": setting.choices,
                        "least": setting.minimum,
                        "most": setting.maximum if largest is None else largest,
                        "help": setting.description,
                    }
                )
        return found
