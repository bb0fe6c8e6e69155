"""Layers that are computed while a page shows them."""

from collections.abc import Collection
from typing import Any

from coded_aperture_ros.core.errors import InputError
from coded_aperture_viewer.settings import Settings


class LayerSwitches:
    """Switches the settings of layers on while a page shows the layer, and back off after that.

    Attributes
    ----------
    chosen : Settings
        What was chosen on the command line and by the controls of the pages.
    shown : frozenset of str
        Names of the layers that pages show.

    Examples
    --------
    >>> from coded_aperture_ros.deblur import DeblurConfig
    >>> from coded_aperture_ros.depth import DepthConfig
    >>> switches = LayerSwitches(Settings(DepthConfig(), DeblurConfig()))
    >>> switches.show({"second"})
    >>> switches.settings.depth.second_surface, switches.chosen.depth.second_surface
    (True, False)
    """

    def __init__(self, chosen: Settings) -> None:
        self.chosen = chosen
        self.shown: frozenset[str] = frozenset()
        # Values of the settings of shown layers that are on for this reason only.
        self._while_shown: dict[str, Any] = {}

    @property
    def settings(self) -> Settings:
        """Settings to process frames with; a layer that does not go with the others is off."""
        settings = self.chosen
        for name, value in self._while_shown.items():
            settings = _changed_or_same(settings, name, value)
        return settings

    def show(self, names: Collection[str]) -> None:
        """Set which layers pages show."""
        self.shown = frozenset(names)
        values = self.chosen.as_values()
        wanted = {
            layer["setting"]: layer["on"]
            for layer in self.chosen.layers()
            if layer["name"] in self.shown and layer["setting"] and not values[layer["setting"]]
        }
        self._while_shown = {
            name: self._while_shown.get(name) or value for name, value in wanted.items()
        }

    def change(self, wanted: Any) -> None:
        """Change settings; those of layers that are on because they are shown, for so long.

        Raises
        ------
        InputError
            As from `Settings.changed`; nothing is changed then.
        """
        if not isinstance(wanted, dict):
            self.chosen.changed(wanted)  # raises
        lasting = {name: value for name, value in wanted.items() if name not in self._while_shown}
        passing = {name: value for name, value in wanted.items() if name in self._while_shown}
        chosen = self.chosen.changed(lasting)
        values = chosen.changed(passing).as_values()
        self.chosen = chosen
        self._while_shown |= {name: values[name] for name in passing}


def _changed_or_same(settings: Settings, name: str, value: Any) -> Settings:
    try:
        return settings.changed({name: value})
    except InputError:
        return settings
