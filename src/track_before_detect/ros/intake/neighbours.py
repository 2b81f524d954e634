"""Other nodes that spoil what this one finds: more than one sender, another of its name."""

from collections.abc import Sequence

from rclpy.node import Node


def senders(node: Node, topics: Sequence[str]) -> list[str]:
    """Return the full names of the nodes that publish on topics, once for each publisher."""
    return sorted(f'{info.node_namespace.rstrip("/")}/{info.node_name}' for topic in topics
                  for info in node.get_publishers_info_by_topic(topic))


def neighbour_warnings(node: Node, topics: Sequence[str]) -> dict[str, str]:
    """Return what is wrong with the nodes around: a kind, for throttling, and a sentence."""
    warnings = {}
    names = senders(node, topics)
    if len(names) > 1:
        warnings['senders'] = (
            f'{len(names)} publishers send frames on {" and ".join(topics)} ({", ".join(names)}): '
            'all are searched as one stream; stop or remap all but one')
    own = (node.get_name(), node.get_namespace())
    count = node.get_node_names_and_namespaces().count(own)
    if count > 1:
        warnings['twins'] = (
            f'{count} nodes are called {node.get_fully_qualified_name()}, so that their topics, '
            'parameters and services are mixed: give one another name or namespace (a killed one '
            'is seen for some seconds more)')
    return warnings
