"""Table of the FMU's variables, from which model descriptions and C tables are generated.

A new variable is one row here and its use in ``sources/plant.c``.
"""

import math
from collections.abc import Sequence
from itertools import accumulate
from typing import Any, Literal, NamedTuple

Causality = Literal["independent", "parameter", "input", "output"]

UNITS: dict[str, dict[str, int]] = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "N/m": {"kg": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
    "kg": {"kg": 1},
    "kg.m2": {"kg": 1, "m": 2},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "Hz": {"s": -1},
    "s": {"s": 1},
    "J": {"kg": 1, "m": 2, "s": -2},
}
"""Unit name -> exponents of the SI base units."""


class Type(NamedTuple):
    """An FMI type definition: quantity, unit and range of a kind of variable."""

    quantity: str
    unit: str | None
    description: str
    min: float | None = None
    max: float | None = None
    items: tuple[str, ...] = ()
    """Names of the values of an enumeration, from 1 on."""
    whole: bool = False

    @property
    def element(self) -> str:
        """Name of the XML element of its variables in FMI 3."""
        return "Enumeration" if self.items else "Int64" if self.whole else "Float64"


TYPES: dict[str, Type] = {
    "Length": Type("Length", "m", "Signed length or coordinate"),
    "Distance": Type("Length", "m", "Length that is never negative", min=0.0),
    "Velocity": Type("Velocity", "m/s", "Linear velocity"),
    "Acceleration": Type("Acceleration", "m/s2", "Linear acceleration"),
    "AngularVelocity": Type("AngularVelocity", "rad/s", "Angular velocity"),
    "AngularAcceleration": Type("AngularAcceleration", "rad/s2", "Angular acceleration"),
    "Force": Type("Force", "N", "Force"),
    "ForceBound": Type("Force", "N", "Largest magnitude of a force", min=0.0),
    "Torque": Type("Torque", "N.m", "Moment"),
    "Mass": Type("Mass", "kg", "Mass", min=0.0),
    "Inertia": Type("MomentOfInertia", "kg.m2", "Element of an inertia tensor"),
    "PrincipalInertia": Type("MomentOfInertia", "kg.m2", "Principal moment of inertia", min=0.0),
    "Stiffness": Type("TranslationalSpringConstant", "N/m", "Stiffness", min=1.0),
    "Damping": Type("TranslationalDampingConstant", "N.s/m", "Viscous damping", min=0.0),
    "Frequency": Type("Frequency", "Hz", "Frequency", min=0.0),
    "Time": Type("Time", "s", "Time"),
    "Energy": Type("Energy", "J", "Energy"),
    "Engagement": Type("Engagement", None, "0 released to 1 fully engaged", min=0.0, max=1.0),
    "Direction": Type("Direction", None, "Component of a direction"),
    "RotationElement": Type("RotationElement", None, "Element of a rotation matrix"),
    "Mixed": Type("Mixed", None, "Array of three linear and three angular components, SI units"),
    "LegSpin": Type(
        "LegSpin", None, "What turns a leg about its own axis", min=1.0, max=2.0, items=("none", "universal")
    ),
    "Layout": Type("Layout", None, "Layout of frames", min=1.0, max=3.0, items=("classic", "fd", "ideal")),
    "NodeNumber": Type("NodeNumber", None, "Node number of a drive", min=1.0, max=127.0, whole=True),
    "BitRate": Type("BitRate", None, "Bit rate in bit/s", min=1e3, max=2e7, whole=True),
    "Duration": Type("Time", "s", "Duration", min=0.0, max=1e4),
    "Spring": Type("TranslationalSpringConstant", "N/m", "Stiffness that can be 0", min=0.0),
}
"""The last five are those of the drives: `plant_fmu.stewart.can`."""


class Variable(NamedTuple):
    """One variable of the FMU; values are flat in C order (last index fastest)."""

    name: str
    type: str
    shape: tuple[int, ...]
    start: tuple[float, ...] | None
    description: str
    types: tuple[str, ...] = ()
    """Type of each element if `type` is Mixed."""
    depends: tuple[str, ...] = ()
    """Inputs that an output depends on directly."""
    behind: tuple[str, ...] = ()
    """Parameters that an output's initial value depends on; empty: all."""
    causality: Causality = "output"

    @property
    def size(self) -> int:
        """Number of elements of the variable."""
        return math.prod(self.shape)


def _ring(radius: float, degrees: tuple[float, ...]) -> tuple[float, ...]:
    angles = [math.radians(angle) for angle in degrees]
    return tuple(x for a in angles for x in (radius * math.cos(a), radius * math.sin(a), 0.0))


INTERNAL_STEP = 1e-4
STEP_SIZE = 1e-3
"""DefaultExperiment stepSize."""
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
ZEROS6 = (0.0,) * 6

_MOTION = ("Velocity",) * 3 + ("AngularVelocity",) * 3
_LENGTHS = ("base_joints", "platform_joints", "initial_position", "initial_rotation")

# Start values: the platform of H. D. Taghirad, Parallel Robots (2013), chapter 5, at its home pose.
# fmt: off
_ROWS: dict[Causality, tuple[tuple[Any, ...], ...]] = {"parameter": (
    ("base_joints", "Length", (6, 3), _ring(2.0, (0, 60, 120, 180, 240, 300)),
     "Joint centres a_i in the base frame"),
    ("platform_joints", "Length", (6, 3), _ring(1.0, (30, 30, 150, 150, 270, 270)),
     "Joint centres b_i in the platform frame"),
    ("mass", "Mass", (), (1150.0,), "Mass of the moving platform"),
    ("com", "Length", (3,), (0.0,) * 3, "Its centre of mass, platform frame"),
    ("inertia", "Inertia", (3, 3), (570.0, 0.0, 0.0, 0.0, 285.0, 0.0, 0.0, 0.0, 285.0),
     "Its inertia about the centre of mass, platform axes"),
    ("cylinder_mass", "Mass", (), (85.0,), "Mass of each leg's lower half"),
    ("cylinder_com", "Distance", (), (0.75,), "Its centre of mass from the base joint, along the leg"),
    ("cylinder_inertia", "PrincipalInertia", (2,), (0.0, 16.0),
     "Its inertia about its centre of mass: axial, transverse"),
    ("rod_mass", "Mass", (), (22.0,), "Mass of each leg's upper half"),
    ("rod_com", "Distance", (), (0.75,), "Its centre of mass from the platform joint, along the leg"),
    ("rod_inertia", "PrincipalInertia", (2,), (0.0, 4.1),
     "Its inertia about its centre of mass: axial, transverse"),
    ("gravity", "Acceleration", (3,), (0.0, 0.0, -9.81), "Gravity in the base frame"),
    ("leg_spin", "LegSpin", (), (1.0,),
     "Legs keep from turning about their axes, or turn as their base universal joints make them"),
    ("universal_joint_base_axes", "Direction", (6, 3), (0.0, 0.0, 1.0) * 6,
     "Base-side hinge axis of each universal joint, base frame, for leg_spin = universal"),
    ("force_bandwidth", "Frequency", (), (0.0,),
     "Corner frequency of the drives' first-order force loop; 0 is ideal"),
    ("viscous_friction", "Damping", (6,), ZEROS6, "Viscous friction along each leg"),
    ("coulomb_friction", "ForceBound", (6,), ZEROS6, "Dry friction along each leg, with stiction"),
    ("reflected_mass", "Mass", (6,), ZEROS6, "Motor and screw inertia seen along each leg"),
    ("length_min", "Distance", (6,), ZEROS6, "Lower end stop of each leg"),
    ("length_max", "Distance", (6,), (1e6,) * 6, "Upper end stop of each leg"),
    ("stop_stiffness", "Stiffness", (), (2e7,), "Stiffness of the end stops"),
    ("stop_damping", "Damping", (), (1e5,), "Damping of the end stops while pressed"),
    ("brake_force", "ForceBound", (6,), (20_000.0,) * 6, "Largest force of each leg's engaged brake"),
    ("initial_position", "Length", (3,), (0.0, 0.0, 1.0), "Platform origin at the start"),
    ("initial_rotation", "RotationElement", (3, 3), IDENTITY, "Platform to base at the start"),
    ("initial_twist", "Mixed", (6,), ZEROS6,
     "Velocity of the platform origin and angular velocity at the start, base frame, m/s and rad/s", _MOTION),
    ("internal_step", "Time", (), (INTERNAL_STEP,), "Fixed step of the integrator (Runge-Kutta 4)"),
), "input": (
    ("force", "Force", (6,), ZEROS6, "Commanded leg forces, > 0 extends"),
    ("brake", "Engagement", (6,), (1.0,) * 6, "Brakes, engaged unless released"),
    ("wrench", "Mixed", (6,), ZEROS6,
     "Force and moment on the platform at its origin, base frame, N and N m",
     ("Force",) * 3 + ("Torque",) * 3),
), "output": (
    ("length", "Length", (6,), None, "Leg lengths, joint centre to joint centre", (), (), _LENGTHS),
    ("rate", "Velocity", (6,), None, "Leg rates", (), (), (*_LENGTHS, "initial_twist")),
    ("applied_force", "Force", (6,), None, "Leg forces behind the force lag, without friction",
     (), ("force",), ("force_bandwidth",)),
    ("position", "Length", (3,), None, "Platform origin in the base frame", (), (), ("initial_position",)),
    ("rotation", "RotationElement", (3, 3), None, "Platform to base", (), (), ("initial_rotation",)),
    ("twist", "Mixed", (6,), None,
     "Velocity of the platform origin and angular velocity, base frame, m/s and rad/s",
     _MOTION, (), ("initial_twist",)),
    ("acceleration", "Mixed", (6,), None, "Time derivative of twist, m/s2 and rad/s2",
     ("Acceleration",) * 3 + ("AngularAcceleration",) * 3, ("force", "brake", "wrench")),
    ("rod_force", "Force", (6,), None, "Leg forces behind friction, brake and reflected mass",
     (), ("force", "brake", "wrench")),
    ("kinetic_energy", "Energy", (), None, "Kinetic energy of platform, legs and reflected masses"),
    ("potential_energy", "Energy", (), None, "Potential energy, zero level through the base origin"),
)}
# fmt: on
"""Arguments of Variable."""
VARIABLES: tuple[Variable, ...] = (
    Variable("time", "Time", (), None, "Simulation time", causality="independent"),
    *(Variable(*row)._replace(causality=causality) for causality, rows in _ROWS.items() for row in rows),
)


def element_name(variable: Variable, element: int) -> str:
    """Name of one element in FMI 2: ``name[i]`` or ``name[i,j]``, counted from 1."""
    if not variable.shape:
        return variable.name
    index = divmod(element, variable.shape[1]) if len(variable.shape) == 2 else (element,)
    return f"{variable.name}[{','.join(str(i + 1) for i in index)}]"


def header(rows: Sequence[Variable], defines: str) -> str:
    """Text of the generated C header model.h for the variables `rows`, with more lines `defines`."""
    values = "\n".join(f"    double {v.name}{f'[{v.size}]' if v.shape else ''};" for v in rows)
    return f"""/* Generated from the variable table. */
#ifndef STEWART_MODEL_H
#define STEWART_MODEL_H

{defines}#define N_VARIABLES {len(rows)}
#define N_VALUES {sum(v.size for v in rows)}

typedef struct {{
{values}
}} Values;

enum {{ INDEPENDENT, PARAMETER, INPUT, OUTPUT }};
enum {{ FLOAT64, INTEGER }};

typedef struct {{
    int offset, count, causality, type;
    double min, max;
}} Variable;

extern const Variable VARIABLES[N_VARIABLES];
extern const double START[N_VALUES];
extern const char *const NAMES[N_VALUES];
extern const unsigned char OWNER[N_VALUES]; /* row of VARIABLES that each value belongs to */
extern const char TOKEN[];

#endif
"""


def tables(token: str, rows: Sequence[Variable]) -> str:
    """Text of the generated C file model.c with an instantiation token, for the variables `rows`."""
    lines = []
    for v, end in zip(rows, accumulate(v.size for v in rows), strict=True):
        low, high = TYPES[v.type].min, TYPES[v.type].max
        kind = "FLOAT64" if TYPES[v.type].element == "Float64" else "INTEGER"
        lines.append(
            f"    {{{end - v.size}, {v.size}, {v.causality.upper()}, {kind}, "
            f"{-1e308 if low is None else low!r}, {1e308 if high is None else high!r}}},"
        )
    elements = [(row, v, k) for row, v in enumerate(rows) for k in range(v.size)]
    start = ", ".join(repr(float(v.start[k] if v.start else 0.0)) for _, v, k in elements)
    names = ", ".join(f'"{element_name(v, k)}"' for _, v, k in elements)
    owner = ", ".join(str(row) for row, _, _ in elements)
    return f"""/* Generated from the variable table: ranges, start values, names, instantiation token. */
#include "model.h"

const Variable VARIABLES[N_VARIABLES] = {{
{chr(10).join(lines)}
}};

const double START[N_VALUES] = {{{start}}};

const char *const NAMES[N_VALUES] = {{{names}}};

const unsigned char OWNER[N_VALUES] = {{{owner}}};

const char TOKEN[] = "{token}";
"""
