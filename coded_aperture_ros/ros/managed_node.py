"""The life of a node: configured, activated, paused and cleaned up, by itself or a manager."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.ros.parameters import NodeParameters

# What a node that ends waits for the frame in work; a camera that is gone may hang for longer.
LONGEST_FRAME_S = 5.0
_SUCCESS, _FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


@dataclasses.dataclass(frozen=True)
class LifeConfig:
    """Who leads the node through its life."""

    autostart: bool = option(
        True,
        "Configure and activate the node at start; false: wait for a lifecycle manager, or for "
        "ros2 lifecycle set",
        read_only=True,
    )


class ManagedNode(ABC, LifecycleNode):
    """A lifecycle node that starts itself unless it is told to wait for a manager.

    A node that derives from this one ends its constructor with `begin`, and implements what
    happens at the transitions. Files are read in `set_up`, so that cleaning up and configuring
    a node reads them again. `configs` and `fixed` are what `NodeParameters` takes.
    """

    def __init__(
        self, name: str, *configs: Any, fixed: Mapping[str, Any], **node_options: Any
    ) -> None:
        super().__init__(name, **node_options)
        self.configs = NodeParameters(self, LifeConfig(), *configs, fixed=fixed)
        self._failure: InputError | None = None
        self._active = self._configured = False
        self._refuse_impossible_transitions()

    def begin(self) -> None:
        """Configure and activate, unless a manager does it; the last thing in a constructor.

        An `InputError` says why the node cannot be configured.
        """
        if not self.configs[LifeConfig].autostart:
            self.get_logger().info("waiting to be configured and activated")
            return
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != _SUCCESS:
                self.close()
                raise self._failure or InputError(f"{self.get_name()} did not start")

    @abstractmethod
    def set_up(self) -> None:
        """Load files, plan the work and create publishers; an `InputError` says why it cannot."""

    @abstractmethod
    def start_work(self) -> None:
        """Begin to take frames."""

    @abstractmethod
    def stop_work(self) -> None:
        """Take no more frames, and wait until the one in work is done."""

    @abstractmethod
    def clean_up(self) -> None:
        """Let go of everything that `set_up` made."""

    def end(self) -> None:
        """End the node's own threads, and let go of files and devices.

        An executor may be waiting for the node's timers and subscriptions meanwhile, so nothing of
        ROS may be destroyed. Where `stop_work` does no more than that, that is all.
        """
        self.stop_work()

    def close(self) -> None:
        """End all work; the node can then be destroyed. May be called again."""
        self._active = False
        self.end()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Set the node up; if that fails it stays unconfigured."""
        done = self._carried_out("be configured", self.set_up)
        self._configured = done == _SUCCESS
        if not self._configured:
            self.clean_up()
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to work."""
        done = self._carried_out("be activated", self.start_work)
        self._active = done == _SUCCESS
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Pause: keep what was set up."""
        self._active = False
        return self._carried_out("be deactivated", self.stop_work)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Become what the node was before it was configured."""
        self._configured = False
        return self._carried_out("be cleaned up", self.clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the work, in whatever state the node is."""
        active, self._active = self._active, False
        configured, self._configured = self._configured, False
        if active:
            self.stop_work()
        return self._carried_out("be shut down", self.clean_up) if configured else _SUCCESS

    def _carried_out(self, what: str, step: Any) -> TransitionCallbackReturn:
        try:
            step()
        except InputError as error:
            self._failure = error
            if not self.configs[LifeConfig].autostart:  # otherwise the program says it
                self.get_logger().error(f"cannot {what}: {error}")
            return _FAILURE
        except Exception as error:  # a manager gets an answer whatever happens
            self._failure = InputError(f"internal error {type(error).__name__}: {error}")
            self.get_logger().error(f"cannot {what}: {self._failure}")
            return _FAILURE
        return _SUCCESS

    def _refuse_impossible_transitions(self) -> None:
        """Answer requests for transitions that the present state does not have.

        rclpy raises an error out of the service then, which would end the program.
        """
        service = self._service_change_state
        change = service.callback

        def answer(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> ChangeState.Response:
            try:
                return change(request, response)
            except Exception as error:
                self.get_logger().warning(f"refused: {str(error).splitlines()[0]}")
                response.success = False
                return response

        service.callback = answer
