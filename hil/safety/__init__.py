"""Safety: checks of each tick for faults and warnings, and force limits. One file for each kind of evidence.

Every rule is a pure function of numbers and small arrays; only `Safety` has state.

=========== ======================================================= ==========================
family      rules                                                   acts as
=========== ======================================================= ==========================
finite      every number is finite                                  NOT_FINITE, LAW
encoders    lost or slipped encoder, uncertain fused pose           ENCODER, UNCERTAIN, warnings
residuals   a leg's length against its rate, its rate against       ENCODER
            force and model; a reading that stands still while its  ENCODER, after two pushes
            leg must move
legs        stale leg; drive in fault, rebooted, or out of RUN      STALE, DRIVE
bus         bus off; sends failing tick after tick                  BUS
frames      another controller, two nodes with one number, another  SECOND_CONTROLLER, SET_UP, ESTOP,
            set-up, refused frames, another node's emergency stop   DUPLICATE_NODE, REFUSED_FRAMES
kinematics  residual, assembly hop, condition of J                  KINEMATICS, ASSEMBLY, CONDITION
stroke      hard ends, square-root speed cap, speed                 STROKE, SPEED
following   leg error against a limit that grows with speed         FOLLOWING
standstill  legs that move on closed brakes                         BRAKE
timing      late and missed ticks                                   warnings, controlled stop
recorder    recorder dead or losing ticks                           warning, controlled stop
certificate growth of V beyond what a stated disturbance allows     CERTIFICATE, or a warning
effort      force, change per tick, change within 250 ms            limits, with a warning
=========== ======================================================= ==========================
"""

from hil.safety.guard import Safety

__all__ = ["Safety"]
