"""What a type of message consists of, as text that readers of bags understand."""

from collections.abc import Iterator
import importlib
import re

# Of the generated Python, where its names differ from those of definitions.
_PLAIN = {'boolean': 'bool', 'octet': 'byte', 'float': 'float32', 'double': 'float64'}

_TYPE = re.compile(r'\w+/msg/[A-Z]\w*')


def message_class(name: str) -> type:
    """Return the class of a type such as ``sensor_msgs/msg/Image``; ImportError without one."""
    if not _TYPE.fullmatch(name):
        raise ImportError(f'{name!r} is no type of a message of ROS')
    package, _, kind = name.split('/')
    try:
        found: type = getattr(importlib.import_module(f'{package}.msg'), kind)
    except AttributeError as error:
        raise ImportError(f'{package} has no message {kind}') from error
    return found


def definition(name: str) -> str:
    """Return the fields of a type, and below a line each those of the types it holds.

    Made from the installed class, so that it is what was sent; constants, which no reader needs,
    are left out.
    """
    parts: dict[str, str] = {}
    _collect(name, parts)
    own, *others = parts.items()
    return own[1] + ''.join(
        f'{"=" * 80}\nMSG: {other.replace("/msg/", "/")}\n{text}' for other, text in others)


def _collect(name: str, parts: dict[str, str]) -> None:
    if name in parts:
        return
    fields = message_class(name).get_fields_and_field_types()  # type: ignore[attr-defined]
    parts[name] = ''.join(f'{_kind(kind)} {field}\n' for field, kind in fields.items())
    for kind in fields.values():
        for inner in _held(kind):
            _collect(inner, parts)


def _kind(kind: str) -> str:
    """Return a type of a field as definitions name it, such as float32[] for sequence<float>."""
    if found := re.fullmatch(r'sequence<(.*?)(?:, (\d+))?>', kind):
        return f'{_kind(found[1])}[{f"<={found[2]}" if found[2] else ""}]'
    if found := re.fullmatch(r'(.*)\[(\d+)\]', kind):
        return f'{_kind(found[1])}[{found[2]}]'
    if found := re.fullmatch(r'(w?string)<(\d+)>', kind):
        return f'{found[1]}<={found[2]}'
    return _PLAIN.get(kind, kind)


def _held(kind: str) -> Iterator[str]:
    for package, name in re.findall(r'(\w+)/(\w+)', kind):
        yield f'{package}/msg/{name}'
