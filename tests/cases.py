"""Many values of one rule as one test."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Any


def for_each(names: str, values: Iterable[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """As `pytest.mark.parametrize`, but in one test: a failure is told with the values it happened at.

    For values that can only fail for the same reason. Fixtures are made once for all of them.
    """
    keys, cases = [name.strip() for name in names.split(",")], list(values)
    assert cases, f"no {names}"

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def all_of_them(**fixtures: Any) -> None:
            for case in cases:
                arguments = dict(zip(keys, case if len(keys) > 1 else [case], strict=True))
                try:
                    test(**arguments, **fixtures)
                except BaseException as error:
                    error.add_note("at " + ", ".join(f"{key} = {value!r}" for key, value in arguments.items()))
                    raise

        whole = inspect.signature(test)
        rest = [parameter for name, parameter in whole.parameters.items() if name not in keys]
        all_of_them.__signature__ = whole.replace(parameters=rest)  # type: ignore[attr-defined]
        return all_of_them

    return decorate
