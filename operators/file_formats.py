"""What operators take from the list of file formats: menu items, filters of the file browser, options as properties."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import bpy

from ..grmm_core.files.format import Format, Option, OptionsOf, options_of_formats
from ..grmm_core.formats import suffixes

_Operator = TypeVar("_Operator", bound=bpy.types.Operator)


def menu_items(entries: Iterable[Format]) -> tuple[tuple[str, str, str], ...]:
    """Items of an enumeration: the suffix identifies a format."""
    return tuple((one.suffix, one.label, one.description) for one in entries)


def listed(entries: Iterable[Format], read: bool = True) -> str:
    """Suffixes of files that are read, or written, for people: ".ply, .splat"."""
    return ", ".join(suffixes(entries) if read else written_suffixes(entries))


def read_filter(entries: Iterable[Format]) -> str:
    """Pattern of a file browser that shows the files that formats read."""
    known = tuple(entries)
    return ";".join([*(f"*{suffix}" for suffix in suffixes(known)), *(name for one in known for name in one.file_names)])


def written_suffixes(entries: Iterable[Format]) -> tuple[str, ...]:
    """Suffixes that formats write."""
    return tuple(one.suffix for one in entries)


def write_filter(entries: Iterable[Format]) -> str:
    """Pattern of a file browser that shows the files that formats write."""
    return ";".join(f"*{suffix}" for suffix in written_suffixes(entries))


def dropped_suffixes(entries: Iterable[Format]) -> str:
    """Suffixes that a file handler takes: those that no other program's files have."""
    return ";".join(suffixes(entries, shared=False))


def has_options(entries: Iterable[Format], which: OptionsOf) -> Callable[[type[_Operator]], type[_Operator]]:
    """Return a decorator that gives an operator the formats' options as properties."""

    def decorate(operator: type[_Operator]) -> type[_Operator]:
        operator.__annotations__ |= {option.identifier: _property(option) for option in options_of_formats(entries, which)}
        return operator

    return decorate


def draw_options(layout: bpy.types.UILayout, operator: bpy.types.Operator, entry: Format, which: OptionsOf) -> None:
    """Draw a format's options."""
    for option in getattr(entry, which):
        layout.prop(operator, option.identifier)


def option_values(operator: bpy.types.Operator, entry: Format, which: OptionsOf) -> dict[str, Any]:
    """Return a format's options as somebody set them, by the names that its reader or writer has for them."""
    values = {}
    for option in getattr(entry, which):
        value = getattr(operator, option.identifier)
        values[option.name] = type(option.default)(value) if option.choices else value
    return values


def _property(option: Option) -> Any:
    common = {"name": option.label, "description": option.description}
    if option.choices:
        items = tuple((str(value), label, f"{option.label} {label}") for value, label in option.choices)
        return bpy.props.EnumProperty(items=items, default=str(option.default), **common)
    kinds = {bool: bpy.props.BoolProperty, int: bpy.props.IntProperty, float: bpy.props.FloatProperty}
    return kinds.get(type(option.default), bpy.props.StringProperty)(default=option.default, **common)
