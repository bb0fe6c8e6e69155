"""Messages of tf2_msgs where the package is missing: PyPI does not have it."""

import sys
from types import SimpleNamespace

from geometry_msgs.msg import TransformStamped


def transform_message():
    """Return the message of transforms; without tf2_msgs, a message that has just one of them."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        type(TransformStamped).__import_type_support__()

        class OfOne(type(TransformStamped)):
            def __call__(cls, transforms):
                return transforms[0]

            def __instancecheck__(cls, message):
                return isinstance(message, TransformStamped)

        class TFMessage(TransformStamped, metaclass=OfOne):
            pass

    return TFMessage


def stand_in(monkeypatch):
    """Return the type of messages that nodes publish on /tf_static from now on."""
    module = SimpleNamespace(TFMessage=transform_message())
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", module)
    monkeypatch.setitem(sys.modules, "tf2_msgs", SimpleNamespace(msg=module))
    return module.TFMessage


def transforms_of(message):
    """Return the transforms of a message of either type."""
    return getattr(message, "transforms", [message])
