"""What the middleware tells of a topic: messages that were lost, others that are not heard."""

from collections.abc import Callable

from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSMessageLostInfo,
    QoSOfferedIncompatibleQoSInfo,
    QoSRequestedIncompatibleQoSInfo,
    SubscriptionEventCallbacks,
)
from rclpy.qos import qos_policy_name_from_kind


def input_events(lost: Callable[[int, int], None],
                 unheard: Callable[[int, str], None]) -> SubscriptionEventCallbacks:
    """Return what is done about events of an input.

    Each kind of event costs every wait of the executor, here and below: the others are left out.

    Parameters
    ----------
    lost : callable
        Takes how many more messages were lost, and how many in all.
    unheard : callable
        Takes how many more publishers offer too little to be heard, and the policy.
    """
    def on_lost(event: QoSMessageLostInfo) -> None:
        lost(event.total_count_change, event.total_count)

    def on_unheard(event: QoSRequestedIncompatibleQoSInfo) -> None:
        unheard(event.total_count_change, qos_policy_name_from_kind(event.last_policy_kind))

    return SubscriptionEventCallbacks(
        message_lost=on_lost, incompatible_qos=on_unheard, use_default_callbacks=False)


def output_events(unheard: Callable[[str], None]) -> PublisherEventCallbacks:
    """Return what is done where a subscriber asks for more than is offered, told the policy."""
    def on_unheard(event: QoSOfferedIncompatibleQoSInfo) -> None:
        unheard(qos_policy_name_from_kind(event.last_policy_kind))

    return PublisherEventCallbacks(incompatible_qos=on_unheard, use_default_callbacks=False)
