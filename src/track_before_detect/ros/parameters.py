"""Parameters of the nodes: declared from one table, checked with one sentence, never ignored.

rclpy drops overrides of undeclared parameters without a word, refuses ``1`` where ``1.0`` is
expected and answers out-of-range values tersely. :class:`ParameterizedNode` checks overrides and
later changes itself before rclpy sees them.
"""

from collections.abc import Iterable, Iterator, Mapping, Set
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import SetParameters
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.validate_topic_name import validate_topic_name

from track_before_detect.checks import checked_number
from track_before_detect.errors import ParameterError, suggestion
from track_before_detect.options import describe, DetectorOptions, is_neutral

INT32_MAX = 2**31 - 1
FLOAT_MAX = 1e308
NEUTRAL = {'number': 0.0, 'integer': 0, 'text': '', 'numbers': [], 'array': ''}


def check_topic_name(name: str, wanted: str, told: str | None = None) -> None:
    """Raise ParameterError where a name is none of a topic.

    Parameters
    ----------
    name : str
        What would be the topic.
    wanted : str
        What the parameter must be, such as ``camera_info must be the name of a topic``.
    told : str, optional
        What it is, if not this name itself.
    """
    try:
        validate_topic_name(name)
    except InvalidTopicNameException as error:
        raise ParameterError(f'{wanted}, got {told or name!r}') from error


@dataclass(frozen=True)
class NodeParameter:
    """One parameter of a node.

    Attributes
    ----------
    name, default, description, unit
        What a user sees.
    kind : {'number', 'integer', 'numbers', 'text', 'texts', 'boolean', 'array'}
        Decides the ROS type; an array is the text that names its file.
    minimum, maximum, above : float, optional
        Inclusive bounds, and an exclusive lower one.
    choices : tuple of str
        Allowed texts; empty when any text will do.
    live : bool
        Whether a change takes effect while the node runs; otherwise it is refused.
    is_option : bool
        Whether this is an option of the detector, which :class:`DetectorOptions` checks.
    optional : bool
        Whether the neutral value (0, empty text, empty list) stands for automatic.
    """

    name: str
    default: Any
    description: str
    kind: str
    unit: str = ''
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False
    is_option: bool = False
    optional: bool = False

    def check(self, value: Any) -> Any:
        """Return ``value`` in its ROS type, or raise ParameterError."""
        if self.is_option:
            if self.optional and is_neutral(value):
                return NEUTRAL[self.kind]
            checked = getattr(DetectorOptions(**{self.name: value}), self.name)
            if self.kind == 'array':
                return str(value)
            return list(checked) if self.kind == 'numbers' else checked
        if self.kind == 'boolean':
            if not isinstance(value, bool):
                raise ParameterError(f'{self.name} must be true or false, got {value!r}')
            return value
        if self.kind in ('text', 'array'):
            return self._check_text(value)
        if self.kind in ('texts', 'numbers'):
            # An empty list has no type, and comes as nothing.
            items = [] if value is None else value
            if not isinstance(items, (list, tuple)):
                raise ParameterError(f'{self.name} must be a list, got {value!r}')
            return [self._check_text(item) if self.kind == 'texts'
                    else checked_number(self.name, item) for item in items]
        return checked_number(self.name, value, whole=self.kind == 'integer', above=self.above,
                              minimum=self.minimum, maximum=self.maximum, unit=self.unit)

    def _check_text(self, value: Any) -> str:
        if not isinstance(value, str):
            raise ParameterError(f'{self.name} must be text, got {value!r}')
        if self.choices and value not in self.choices:
            raise ParameterError(
                f'{self.name} must be one of {", ".join(self.choices)}, got {value!r}')
        return value

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor: meaning, unit, range and choices."""
        unit = f' [{self.unit}]' if self.unit else ''
        constraints = []
        if self.choices:
            constraints.append('one of ' + ', '.join(self.choices))
        if self.above is not None:
            constraints.append(f'above {self.above:g}')
        if self.optional:
            neutral = {'text': 'empty', 'array': 'empty', 'numbers': 'an empty list'}.get(
                self.kind, '0')
            constraints.append(f'{neutral} means automatic')
        descriptor = ParameterDescriptor(
            description=self.description + unit, read_only=not self.live,
            additional_constraints='; '.join(constraints))
        if self.kind in ('number', 'integer') and not self._unbounded():
            lowest = self.minimum if self.minimum is not None else self.above
            lowest = 0.0 if self.optional else lowest
            if self.kind == 'integer':
                lowest = -INT32_MAX if lowest is None else lowest
                highest = INT32_MAX if self.maximum is None else self.maximum
                descriptor.integer_range = [
                    IntegerRange(from_value=int(lowest), to_value=int(highest), step=0)]
            else:
                lowest = -FLOAT_MAX if lowest is None else lowest
                highest = FLOAT_MAX if self.maximum is None else self.maximum
                descriptor.floating_point_range = [FloatingPointRange(
                    from_value=float(lowest), to_value=float(highest), step=0.0)]
        return descriptor

    def _unbounded(self) -> bool:
        return self.minimum is None and self.maximum is None and self.above is None


def option_parameters(defaults: Mapping[str, Any]) -> list[NodeParameter]:
    """Return a live parameter for every option of the detector.

    Parameters
    ----------
    defaults : mapping
        Defaults that differ from those of :class:`DetectorOptions`.
    """
    parameters = []
    for entry in describe():
        default = defaults.get(entry['name'], entry['default'])
        if default is None:
            default = NEUTRAL[entry['kind']]
        if entry['kind'] == 'numbers':
            default = list(default)
        parameters.append(NodeParameter(
            name=entry['name'], default=default, description=entry['description'],
            kind=entry['kind'], unit=entry['unit'], minimum=entry['minimum'],
            maximum=entry['maximum'], above=entry['above'], choices=entry['choices'] or (),
            live=True, is_option=True, optional=entry['optional']))
    return parameters


def option_values(parameters: Iterable[NodeParameter], values: Mapping[str, Any],
                  ) -> dict[str, Any]:
    """Return those of the values that are options of a detector, checked, None for automatic."""
    options = {
        parameter.name: None if parameter.optional and is_neutral(values[parameter.name])
        else values[parameter.name]
        for parameter in parameters if parameter.is_option and parameter.name in values}
    checked = DetectorOptions.from_mapping(options)
    return {name: getattr(checked, name) for name in options}


class _TogetherService(ParameterService):
    """Sets the parameters of a call, such as those of a file, as one change.

    The service of rclpy sets one after the other: the order would decide whether values that go
    together are refused.
    """

    def __init__(self, node: Node) -> None:
        self._set = node.set_parameters
        super().__init__(node)

    def _set_parameters_callback(self, request: SetParameters.Request,
                                 response: SetParameters.Response) -> SetParameters.Response:
        response.results = self._set(
            [Parameter.from_parameter_msg(parameter) for parameter in request.parameters])
        return response


class ParameterizedNode(Node):
    """Node whose parameters are declared from a table.

    Parameters
    ----------
    name : str
        Name of the node.
    parameters : list of NodeParameter
        What is declared.
    **settings
        Of :class:`rclpy.node.Node`: context, namespace, parameter_overrides and so on.

    Raises
    ------
    ParameterError
        When a value given at start cannot be used.
    """

    def __init__(self, name: str, parameters: list[NodeParameter], **settings: Any):
        # Not super(): beside it a managed node has another base class, started on its own.
        Node.__init__(self, name, start_parameter_services=False, **settings)
        self._parameter_services = _TogetherService(self)
        self._table = {parameter.name: parameter for parameter in parameters}
        # Names of the parameters that were given a value, be it the default.
        self._told = self._table.keys() & self._parameter_overrides.keys()
        values = self._overridden(parameters)
        more = self.further_parameters(values)
        values.update(self._overridden(more))
        self._table.update({parameter.name: parameter for parameter in more})
        self.check_values(values, self._told)
        for parameter in self._table.values():
            # The override was checked above and may have been turned from 1 to 1.0.
            self.declare_parameter(
                parameter.name, values[parameter.name], parameter.descriptor(),
                ignore_override=True)

    def values(self) -> dict[str, Any]:
        """Return the value of every parameter of the table."""
        return {name: _plain(self.get_parameter(name).value) for name in self._table}

    def further_parameters(self, values: Mapping[str, Any]) -> list[NodeParameter]:
        """Return parameters that there are because others have these values."""
        return []

    def _overridden(self, parameters: Iterable[NodeParameter]) -> dict[str, Any]:
        """Return the values of parameters at the start."""
        values = {}
        for parameter in parameters:
            override = self._parameter_overrides.get(parameter.name)
            given = parameter.default if override is None else _plain(override.value)
            values[parameter.name] = parameter.check(given)
        return values

    def check_values(self, values: Mapping[str, Any], told: Set[str]) -> None:
        """Raise ParameterError when values do not go together; ``told`` names those given."""

    def on_change(self, names: list[str]) -> None:
        """Act on parameters that were changed while the node runs."""

    def finish_parameters(self) -> None:
        """Say which parameters are not the default; refuse those that do not exist.

        Called once everything is declared, also what rclpy declares for quality of service.
        """
        for name in self._parameter_overrides:
            if not self.has_parameter(name):
                raise ParameterError(self._unknown(name))
        given = [f'{name}={value}' for name, value in self.values().items()
                 if value != self._table[name].default]
        self.get_logger().info(
            f'parameters that are not the default: {", ".join(given) or "none"}')

    @contextmanager
    def overridable_qos(self) -> Iterator[None]:
        """Turn what rclpy raises for a bad override of quality of service to ParameterError."""
        try:
            yield
        except (InvalidQosOverridesError, RuntimeError) as error:
            raise ParameterError(str(error)) from error

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Set parameters together if they can be, else each that can; one change either way."""
        whole, changed = self._set(parameter_list)
        results = [whole] * len(parameter_list)
        if not whole.successful:
            each = [self._set([parameter]) for parameter in parameter_list]
            results = [result for result, _ in each]
            changed = [name for _, names in each for name in names]
        if changed:
            self.on_change(changed)
        return results

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, refusing what cannot be used with a sentence that says why."""
        result, changed = self._set(parameter_list)
        if changed:
            self.on_change(changed)
        return result

    def _set(self, parameter_list: list[Parameter]) -> tuple[SetParametersResult, list[str]]:
        """Set parameters all or none; return the answer, and the names of those that changed."""
        before = self.values()
        try:
            checked = self._checked_changes(parameter_list)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error)), []
        result = super().set_parameters_atomically(checked)
        if not result.successful:
            return result, []
        names = [parameter.name for parameter in checked if parameter.name in self._table]
        # One that is told its value for the first time no longer goes by the preset.
        changed = [name for name in names
                   if name not in self._told or self.values()[name] != before[name]]
        self._told |= set(names)
        return result, changed

    def _checked_changes(self, parameter_list: list[Parameter]) -> list[Parameter]:
        values = self.values()
        checked, told = [], set(self._told)
        for parameter in parameter_list:
            if not self.has_parameter(parameter.name):
                raise ParameterError(self._unknown(parameter.name))
            known = self._table.get(parameter.name)
            if known is None:
                checked.append(parameter)
                continue
            value = known.check(_plain(parameter.value))
            if known.live:
                values[parameter.name] = value
                told.add(parameter.name)
                checked.append(Parameter(parameter.name, value=value))
            elif value != values[parameter.name]:
                raise ParameterError(
                    f'{parameter.name} cannot be changed while the node runs; '
                    'give it when the node is started')
        self.check_values(values, told)
        return checked

    def _unknown(self, name: str) -> str:
        return f'unknown parameter {name!r}; {suggestion(name, self._table)}'


def _plain(value: Any) -> Any:
    """Return arrays of rclpy as lists."""
    return value if isinstance(value, (str, bool, int, float)) or value is None else list(value)
