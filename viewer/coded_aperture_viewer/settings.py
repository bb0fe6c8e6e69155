"""Settings that pages can change while frames are processed."""

import dataclasses
import sys
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import check_options, option, options_of
from coded_aperture_ros.core.text import short
from coded_aperture_ros.deblur import DeblurConfig
from coded_aperture_ros.depth import DepthConfig
from coded_aperture_ros.depth.stages import stage_modules
from coded_aperture_viewer.packet import METRES, SHARES

PICTURES = ("none", "sharp", "refocused")
# Settings with a slider, box or list on the page, by part, and the end of the slider where the
# whole range of the setting would be too long.
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
    """Settings of the picture that one page shows; every page has its own."""

    picture: str = option("sharp", "none, all-in-focus, or refocused", choices=PICTURES)
    focus_m: float = option(1.0, "Distance in focus.", unit="m", within=(1e-3, 1e6))
    opening_px: float = option(
        10.0,
        "Radius of the blur of the nearest depth if the farthest is in focus.",
        unit="px",
        within=(0.0, 30.0),
    )

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def made_from(self) -> "LookConfig":
        """The same picture, without the settings that do not change it."""
        return self if self.picture == "refocused" else LookConfig(self.picture)

    def as_values(self) -> dict[str, Any]:
        """Values by the names that `Settings.changed` takes."""
        return {f"look.{name}": getattr(self, name) for name in options_of(self)}


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Settings of the sequence of frames."""

    paused: bool = option(False, "Process the same frame again whenever a setting changes.")

    def __post_init__(self) -> None:
        check_options(self)


@dataclasses.dataclass(frozen=True)
class Settings:
    """Settings that one page sees: those of its own picture, and those that all pages share.

    Examples
    --------
    >>> settings = Settings(DepthConfig(), DeblurConfig())
    >>> settings.changed({"look.focus_m": 2}).look.focus_m
    2.0
    """

    depth: DepthConfig
    deblur: DeblurConfig
    run: RunConfig = RunConfig()
    look: LookConfig = LookConfig()

    def with_look(self, look: LookConfig) -> "Settings":
        """The same shared settings, with the look of a page."""
        return dataclasses.replace(self, look=look)

    def changed(self, wanted: Any) -> "Settings":
        """Settings with some values changed: `{"depth.smoothness": 2, ...}`.

        Raises
        ------
        InputError
            If pages cannot change such a setting, or a value is not allowed.
        """
        if not isinstance(wanted, dict):
            raise InputError(f"settings: expected names and values, got {short(wanted)}")
        parts: dict[str, dict[str, Any]] = {}
        allowed = self.as_values()
        for name, value in wanted.items():
            if name not in allowed:
                raise InputError(f"settings: there is no {name:.60}")
            part, _, field = name.partition(".")
            parts.setdefault(part, {})[field] = _typed(value, allowed[name])
        return dataclasses.replace(
            self,
            **{
                part: dataclasses.replace(getattr(self, part), **values)
                for part, values in parts.items()
            },
        )

    def as_values(self) -> dict[str, Any]:
        """Values of the settings that pages can change, by the names that `changed` takes."""
        names = {part: list(fields) for part, fields in _CONTROLS.items() if part != "look"}
        names["run"] = list(options_of(self.run))
        return {
            f"{part}.{field}": getattr(getattr(self, part), field)
            for part, fields in names.items()
            for field in fields
        } | self.look.as_values()

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
                        "shared": is_shared(f"{part}.{name}"),
                    }
                )
        return found


def is_shared(name: str) -> bool:
    """Whether all pages share a setting."""
    return not name.startswith("look.")


def _typed(value: Any, current: Any) -> Any:
    """Value, as a float where the current one is; JSON does not distinguish 1 and 1.0."""
    is_integer = type(value) is int and abs(value) <= sys.float_info.max
    return float(value) if is_integer and isinstance(current, float) else value
