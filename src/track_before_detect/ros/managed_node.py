"""A managed node, one with a lifecycle, that starts itself unless told not to."""

from collections.abc import Callable
import threading
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNodeMixin, TransitionCallbackReturn

from track_before_detect.ros.parameters import NodeParameter, ParameterizedNode

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = 'unconfigured', 'inactive', 'active', 'finalized'
AUTOSTART = NodeParameter(
    'autostart', True, 'Whether the node configures and activates itself; otherwise whoever '
    'manages its lifecycle does.', 'boolean')


class ManagedNode(LifecycleNodeMixin, ParameterizedNode):
    """Node with a lifecycle, whose parameters are declared from a table.

    What a transition does is up to ``on_configure`` and the others of the base class; those of a
    start by itself run in a thread of their own, so that the executor goes on meanwhile.

    Parameters
    ----------
    name, parameters, **settings
        As of :class:`ParameterizedNode`.
    """

    def __init__(self, name: str, parameters: list[NodeParameter], **settings: Any):
        ParameterizedNode.__init__(self, name, parameters, **settings)
        LifecycleNodeMixin.__init__(self)
        self._in_transition = threading.Lock()
        self._starting: threading.Thread | None = None
        service = self._service_change_state
        self._change_state: Callable[
            [ChangeState.Request, ChangeState.Response], ChangeState.Response] = service.callback
        service.callback = self._serve_change_state

    @property
    def lifecycle_state(self) -> str:
        """Label of the state: unconfigured, inactive, active, or of a transition."""
        return self._state_machine.current_state[1]

    def start_up(self) -> None:
        """Configure and activate the node, in another thread."""
        self._starting = threading.Thread(target=self._start_up, name='starting', daemon=True)
        self._starting.start()

    def wait_for_start(self, timeout_s: float) -> None:
        """Wait until a start that is under way has ended."""
        if self._starting is not None:
            self._starting.join(timeout_s)

    def _start_up(self) -> None:
        with self._in_transition:
            if (self.lifecycle_state == UNCONFIGURED
                    and self.trigger_configure() == TransitionCallbackReturn.SUCCESS):
                self.trigger_activate()

    def _serve_change_state(self, request: ChangeState.Request, response: ChangeState.Response,
                            ) -> ChangeState.Response:
        """Change the state; that of rclpy ends the node for a transition that is not possible."""
        response.success = False
        wanted = request.transition.label or request.transition.id
        if not self._in_transition.acquire(blocking=False):
            self.get_logger().warning(
                f'transition {wanted} refused: the node is {self.lifecycle_state}')
            return response
        try:
            return self._change_state(request, response)
        except rclpy_implementation.RCLError:
            self.get_logger().warning(
                f'transition {wanted} refused: it is not possible from {self.lifecycle_state}')
            return response
        finally:
            self._in_transition.release()
