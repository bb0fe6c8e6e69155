"""Lifecycle of a node: configured, activated, paused and cleaned up, by itself or a manager."""

import dataclasses
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from coded_aperture_ros.core.errors import InputError
from coded_aperture_ros.core.options import option
from coded_aperture_ros.ros.given_parameters import unused_parameters
from coded_aperture_ros.ros.parameters import NodeParameters

# Longest wait at shutdown for the frame in work: reading an unplugged camera may block for longer.
LONGEST_FRAME_S = 5.0
_SUCCESS = TransitionCallbackReturn.SUCCESS
_FAILURE = TransitionCallbackReturn.FAILURE


@dataclasses.dataclass(frozen=True)
class LifeConfig:
    """Whether the node starts itself, or a lifecycle manager does."""

    autostart: bool = option(
        True,
        "Configure and activate the node at start; false: wait for a lifecycle manager, or for "
        "ros2 lifecycle set",
        read_only=True,
    )


class ManagedNode(ABC, LifecycleNode):
    """Lifecycle node that starts itself, unless `autostart` is false.

    A subclass ends its constructor with `begin`, and implements what happens at the transitions.
    Files are read in `set_up`, so that cleaning up and configuring a node reads them again.

    Parameters
    ----------
    name : str
    *configs, fixed
        As of `NodeParameters`.
    shares_arguments : bool, optional
        Whether the program has other nodes, for which its arguments may be.
    **node_options
        As of rclpy's `LifecycleNode`.

    Attributes
    ----------
    configs : NodeParameters
    """

    def __init__(
        self,
        name: str,
        *configs: Any,
        fixed: Mapping[str, Any],
        shares_arguments: bool = False,
        **node_options: Any,
    ) -> None:
        super().__init__(name, **node_options)
        self.configs = NodeParameters(self, LifeConfig(), *configs, fixed=fixed)
        arguments = node_options.get("cli_args") or sys.argv
        for line in unused_parameters(self, arguments, shares_arguments):
            self.get_logger().warning(line)
        self._failure: InputError | None = None
        self._active = False
        self._configured = False
        self._refuse_impossible_transitions()

    def begin(self) -> None:
        """Configure and activate, unless a manager does it; the last call in a constructor.

        Raises
        ------
        InputError
            If the node cannot be configured or activated.
        """
        if not self.configs[LifeConfig].autostart:
            self.get_logger().info("waiting for a lifecycle manager to configure and activate it")
            return
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != _SUCCESS:
                self.close()
                raise self._failure or InputError(f"{self.get_name()} did not start: see its log")

    @abstractmethod
    def set_up(self) -> None:
        """Load files, prepare the work and create publishers; may raise an `InputError`."""

    @abstractmethod
    def start_work(self) -> None:
        """Start to process frames."""

    @abstractmethod
    def stop_work(self) -> None:
        """Stop processing frames, and wait for the one in work."""

    @abstractmethod
    def clean_up(self) -> None:
        """Release everything that `set_up` made."""

    def end(self) -> None:
        """End the node's own threads, and release files and devices.

        An executor may still wait for the node's timers and subscriptions, so none of them may be
        destroyed. A node whose `stop_work` destroys some overrides this method.
        """
        self.stop_work()

    def close(self) -> None:
        """End all work; the node can then be destroyed. May be called again."""
        self._active = False
        self.end()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Set the node up; if that fails it stays unconfigured."""
        done = self._try_step("configure", self.set_up)
        self._configured = done == _SUCCESS
        if not self._configured:
            self.clean_up()
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to work."""
        done = self._try_step("activate", self.start_work)
        self._active = done == _SUCCESS
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Pause: keep what was set up."""
        self._active = False
        return self._try_step("deactivate", self.stop_work)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release what was set up: the node is unconfigured again."""
        self._configured = False
        return self._try_step("clean up", self.clean_up)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the work, in whatever state the node is."""
        active, self._active = self._active, False
        configured, self._configured = self._configured, False
        if active:
            self.stop_work()
        return self._try_step("shut down", self.clean_up) if configured else _SUCCESS

    def _try_step(self, transition: str, step: Callable[[], None]) -> TransitionCallbackReturn:
        """Result of a step of a transition; a failure is kept, and logged if a manager leads."""
        try:
            step()
        except InputError as error:
            self._failure = error
            if not self.configs[LifeConfig].autostart:  # otherwise the program prints it
                self.get_logger().error(f"cannot {transition}: {error}")
            return _FAILURE
        except Exception as error:  # a manager has to get an answer in any case
            self._failure = InputError(f"internal error {type(error).__name__}: {error}")
            self.get_logger().error(f"cannot {transition}: {self._failure}")
            return _FAILURE
        return _SUCCESS

    def _refuse_impossible_transitions(self) -> None:
        """Answer requests for transitions that the present state does not have with a refusal.

        rclpy raises an error in the service then, which would end the program.
        """
        service = self._service_change_state
        change = service.callback

        def answer(
            request: ChangeState.Request, response: ChangeState.Response
        ) -> ChangeState.Response:
            try:
                return change(request, response)
            except Exception as error:
                self.get_logger().warning(f"transition refused: {str(error).splitlines()[0]}")
                response.success = False
                return response

        service.callback = answer
