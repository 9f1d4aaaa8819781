"""C tables from the variable table: offsets, start values, ranges and the instantiation token."""

from plant_fmu.stewart.variables import VARIABLES, limits

_CAUSALITY = {"independent": "INDEPENDENT", "parameter": "PARAMETER", "input": "INPUT", "output": "OUTPUT"}


def offsets() -> dict[str, int]:
    """Index of each variable's first element in the flat list of all values."""
    table: dict[str, int] = {}
    n = 0
    for variable in VARIABLES:
        table[variable.name] = n
        n += variable.size
    return table


def header() -> str:
    """Return model.h."""
    places = offsets()
    total = sum(v.size for v in VARIABLES)
    first_output = min(places[v.name] for v in VARIABLES if v.causality == "output")
    names = "\n".join(f"    V_{name} = {place}," for name, place in places.items())
    return f"""/* Generated from the variable table: where each variable lies in Plant.v. */
#ifndef STEWART_MODEL_H
#define STEWART_MODEL_H

#define N_VARIABLES {len(VARIABLES)}
#define N_VALUES {total}
#define FIRST_OUTPUT {first_output}

enum {{
{names}
}};

enum {{ INDEPENDENT, PARAMETER, INPUT, OUTPUT }};
enum {{ FLOAT64, ENUMERATION }};

typedef struct {{
    const char *name;
    int offset, count, columns, causality, type;
    double min, max;
}} Variable;

extern const Variable VARIABLES[N_VARIABLES];
extern const double START[N_VALUES];
extern const unsigned char OWNER[N_VALUES]; /* row of VARIABLES that each value belongs to */
extern const char TOKEN[];

#endif
"""


def tables(token: str) -> str:
    """Return model.c with the given instantiation token."""
    places = offsets()
    rows = []
    start: list[str] = []
    owner: list[str] = []
    for row, v in enumerate(VARIABLES):
        owner += [str(row)] * v.size
        low, high = limits(v)
        columns = v.shape[1] if len(v.shape) == 2 else 0
        kind = "ENUMERATION" if v.type == "LegSpin" else "FLOAT64"
        rows.append(
            f'    {{"{v.name}", {places[v.name]}, {v.size}, {columns}, {_CAUSALITY[v.causality]}, {kind}, '
            f"{-1e308 if low is None else low!r}, {1e308 if high is None else high!r}}},"
        )
        start += [repr(float(x)) for x in v.start or (0.0,) * v.size]
    return f"""/* Generated from the variable table: names, ranges, start values, instantiation token. */
#include "model.h"

const Variable VARIABLES[N_VARIABLES] = {{
{chr(10).join(rows)}
}};

const double START[N_VALUES] = {{{", ".join(start)}}};

const unsigned char OWNER[N_VALUES] = {{{", ".join(owner)}}};

const char TOKEN[] = "{token}";
"""
