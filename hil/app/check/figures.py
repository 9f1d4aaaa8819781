"""Figures that `hil check` prints, one function per section of its report."""

import numpy as np

from drivers.can.hardware_stamps import stamped_by
from drivers.config import UDP
from drivers.signals import LEGS
from drivers.transmission import Transmission
from hil.app.adapter.qualification import differences, judge, qualifications
from hil.app.check.report import Report
from hil.app.check.subject import carried, controlled_stop_m, refused
from hil.app.configuration.bus_budget import bus_budgets, bus_names, set_up_ns
from hil.app.configuration.payload_box import shown_ranges
from hil.app.configuration.platform import pose_arrays
from hil.app.loop_delay import observer_of
from hil.loop.clock import real_time_rights
from hil.loop.report import KEPT
from hil.robot.kinematics import condition, leg_lengths


def robot(r: Report) -> None:
    """Add leg lengths, static forces and the condition number at home to the report."""
    s = r.s
    home = pose_arrays(s.c.platform.home)
    q = leg_lengths(s.model.platform, *home)
    r.figures["home"] = figures = {
        "leg_lengths_m": q.tolist(),
        "static_forces_N": s.static_N.tolist(),
        "condition": float(condition(s.model.platform, *home)),
    }
    r.add(
        "robot at home",
        """
        leg lengths    {lengths} m (allowed {c.platform.length_min_m:g} to {c.platform.length_max_m:g})
        static forces  {forces} N
        condition of J {condition:.2f} (limit {c.limits.condition:g})
        """,
        figures,
        lengths=" ".join(f"{each:.4f}" for each in q),
        forces=" ".join(f"{each:.1f}" for each in s.static_N),
    )


def bus(r: Report) -> None:
    """Add the time budget of each bus to the report."""
    s, c = r.s, r.s.c
    names = zip(c.bus.buses, bus_names(c.bus), strict=True)
    titles = [f"bus {each.interface} {name}, layout {each.layout}" for each, name in names]
    budgets = bus_budgets(c.bus, c.drives, c.sensors, c.loop.rate_Hz, c.folder)
    if not budgets:
        r.add(titles[0], "no bus time: this layout exists only in lockstep (hil sim)")
        return
    found = []
    set_up = set_up_ns(c.bus, s.protocol)
    for title, each, budget, answer_us, ns in zip(
        titles, c.bus.buses, budgets, s.answers_us, set_up, strict=True
    ):
        if each.interface == UDP:
            found.append({"load_percent": 0.0})
            r.add(title, "datagrams: no bus time")
            continue
        if each.interface == "socketcan":
            r.add(title, f"time stamps of {stamped_by(each)}")
        figures = {
            "load_percent": budget.load_percent,
            "total_us": budget.total_ns / 1e3,
            "allowed_rate_Hz": budget.allowed_rate_Hz,
            "feedback_us": answer_us,
            "set_up_us": 1e-3 * ns,
        }
        found.append(figures)
        filled = 1e-4 * c.loop.rate_Hz * (figures["total_us"] + figures["set_up_us"])
        r.add(title, budget.table())
        r.add(
            title,
            """
            highest rate at {allowed:g} %: {allowed_rate_Hz:.0f} Hz
            SYNC to last feedback {answer_us:.0f} us of a window of {s.window_us:.0f} us
            set-up of the drives, brakes closed: {set_up_us:.0f} us more, {filled:.1f} % in total{waits}
            """,
            figures,
            allowed=budget.max_load_percent,
            answer_us=answer_us or None,
            filled=filled if ns else None,
            waits="" if filled <= 100.0 else "; the rest waits for the next tick",
        )
    for index, (title, q) in enumerate(zip(titles, qualifications(c), strict=True)):
        if q is None:
            continue
        verdict = judge(c, index, q)
        if verdict.refused:
            raise refused(c, verdict.refused, path=("bus",))
        s.adapters += verdict.warnings
        found[index] |= {"adapter_us": verdict.answer_us, "adapter_loss": q.loss}
        r.add(
            title,
            """
            adapter {q.adapter}, measured {q.date}: {q.lost} of {q.sent} frames lost
            SYNC to last feedback {adapter_us:.0f} us with its longest latency, {q.longest_us:.0f} us
            """,
            found[index],
            q=q,
        )
    s.adapters += differences(c)
    r.figures["bus"] = max(found, key=lambda each: each["load_percent"])
    if c.bus.channels:
        by_channel = {each.channel: own for each, own in zip(c.bus.buses, found, strict=True)}
        r.figures["bus"] = r.figures["bus"] | {"channels": by_channel}


def drives(r: Report) -> None:
    """Add watchdog, brakes and force resolution of the drives to the report."""
    s, c = r.s, r.s.c
    silence, ramp_s = c.reactions.silence, c.engage.force_ramp_s
    watched, ends = s.protocol.traits.has_watchdog, silence in {"damp", "hold"}
    r.figures["drives"] = figures = {
        "watchdog_periods": c.drives.watchdog_ms / (1e3 / c.loop.rate_Hz) if watched else None,
        "reaction": silence if watched else None,
        "force_step_N": s.force_step_N,
    }
    left_m = (
        "" if s.stepped_error_m is None else f", which leaves up to {1e3 * s.stepped_error_m:.3g} mm at rest"
    )
    r.add(
        "drives",
        """
        nodes {nodes}; rated force {c.drives.force_limit_N:g} N
        watchdog {c.drives.watchdog_ms:g} ms, {watchdog_periods:.1f} periods; then {reaction}{then}
        watchdog not set from here: when the controller falls silent {kept}
        brakes get {e.brake_release_s:milli.6g} ms to open, {e.closing_s:milli.6g} ms to close
        brake tests take {ramp_s:g} s; a leg may move by {c.limits.standstill_m:milli.6g} mm
        no brake tests, as engage.force_ramp_s is {off:g}
        force resolution {step_N:.2g} N at the leg{left}
        emulated brakes {hold}open in {opens_ms:g} ms, close in {plant.brake_close_ms:g} ms
        """,
        figures,
        nodes=", ".join(map(str, c.drives.node_ids)),
        then=f", after {c.drives.brake_after_ms:g} ms brake" if ends else "",
        kept=None if watched else KEPT,
        e=c.engage,
        ramp_s=ramp_s if ramp_s > 0.0 else None,
        off=None if ramp_s > 0.0 else ramp_s,
        step_N=s.force_step_N or None,
        left=left_m,
        hold=f"hold {s.stewart.brake_force_N:g} N each, " if s.stewart else "",
        opens_ms=c.plant and c.plant.drives.brake_open_ms,
        plant=c.plant and c.plant.drives,
    )


def transmission(r: Report) -> None:
    """Add turns, speed and torque of each leg's motor to the report."""
    c = r.s.c
    if c.drives.transmission is None:
        return
    gear = Transmission(c.drives.transmission)
    figures = {
        "m_per_turn": gear.m_per_turn,
        "turns_retracted": gear.turns(np.full(LEGS, c.platform.length_min_m)),
        "turns_extended": gear.turns(np.full(LEGS, c.platform.length_max_m)),
        "N_per_Nm": gear.N_per_Nm,
        "rpm": 60.0 * c.limits.speed_m_s / np.abs(gear.m_per_turn),
        "holding_Nm": gear.torque(r.s.static_N),
        "rated_Nm": np.abs(c.drives.force_limit_N / gear.N_per_Nm / gear.driving),
    }
    r.figures["transmission"] = {name: values.tolist() for name, values in figures.items()}
    scaled = figures | {"m_per_turn": 1e3 * gear.m_per_turn, "N_per_Nm": np.abs(gear.N_per_Nm)}
    row = "{:<3d} {:+7.4g} {:+8.4g} to {:+8.4g} {:7.4g} {:5.0f} {:+8.4f} {:7.4f}"
    r.add("motor to leg", "leg mm/turn    turns at the ends   N/N m   rpm N m held   rated")
    for leg in range(LEGS):
        r.add("motor to leg", row.format(leg, *(values[leg] for values in scaled.values())))
    r.add(
        "motor to leg",
        """
        turns as the drive reports them, > 0 extends the leg, at the retracted and
        extended end; rpm at limits.speed_m_s; N m held: torque that holds the
        platform at home, without losses; rated: for drives.force_limit_N, with losses
        """,
    )


def controller(r: Report) -> None:
    """Add control law, model and stability margins to the report."""
    s = r.s
    r.add("controller", "law {c.controller.law}\nmodel {variant}", variant=s.variant or None)
    if s.switches:
        r.add("controller", "no boundary layer: the law switches")
    elif s.margin is not None:
        r.figures["controller"] = s.margin
        text = "crosses over at {cross_over_rad_s:.0f} rad/s; {delay_ms:.1f} ms of delay{more} cost about "
        text += "{phase_loss_deg:.0f} of {whole:.0f} degrees of phase margin"
        whole = s.margin["phase_loss_deg"] + s.margin["phase_margin_deg"]
        more = "" if observer_of(s.c) is None else " and the observer of the wrench"
        r.add("controller", text, s.margin, whole=whole, more=more)
    if s.designed is not None:
        r.figures["controller"] = s.designed.figures
        r.sections["controller"] += s.designed.lines
    r.sections["controller"] += s.c.controller.described()


def stability(r: Report) -> None:
    """Add the result of the stability proof to the report, in one line."""
    from hil.app.stability.command import judge  # noqa: PLC0415 - scipy, which `hil run` and `hil sim` do without

    found = r.s.proven = judge(r.s.c, tell=r.s.tell)
    r.figures["stability"] = {
        each: getattr(found, each) for each in ("status", "claim", "conditions", "premises")
    }
    r.add("controller", "stability {found.status}: {found.claim}", found=found)
    spare_ms, premises = found.figures.get("delay_to_spare_ms"), "; ".join(found.premises)
    r.add(
        "controller", "  while {premises}; {spare_ms:.3g} ms to spare", premises=premises, spare_ms=spare_ms
    )


def reference(r: Report) -> None:
    """Add the demands of the reference on the legs, and the travel of stops, to the report."""
    s, c, w = r.s, r.s.c, r.s.walk
    swings, whole_s = w.swings(s.period_s), s.trajectory.duration_s
    r.figures["reference"] = figures = {
        "until_braked_m": s.silence.travel_m(w) if s.silence else None,
        "controlled_stop_m": controlled_stop_m(c, w),
        "duration_s": whole_s,
        "length_min_m": float(w.q.min()),
        "length_max_m": float(w.q.max()),
        "rate_max_m_s": s.fastest_m_s,
        "acceleration_max_m_s2": float(np.abs(w.ddq).max()),
        "force_min_N": float(w.tau.min()),
        "force_max_N": float(w.tau.max()),
        "force_step_N": s.own_step_N,
        "force_window_N": None if swings is None else float(swings.max()),
        "condition_max": float(w.condition.max()),
    }
    if s.setpoints is not None:
        names = "setpoint_rate_max_m_s", "setpoint_acceleration_max_m_s2"
        r.figures["reference"] |= dict(zip(names, s.setpoints, strict=True))
    limit_m_s2 = c.limits.acceleration_m_s2
    r.add(
        f"reference {c.reference.type}, {'until stopped' if whole_s is None else f'{whole_s:g} s'}",
        """
        leg lengths    {length_min_m:.4f} to {length_max_m:.4f} m
        leg rates      up to {rate_max_m_s:.3f} m/s (limit {c.limits.speed_m_s:g})
        accelerations  up to {acceleration_max_m_s2:.3f} m/s^2 (limit {limit})
        leg forces     {force_min_N:.0f} to {force_max_N:.0f} N (limit {c.limits.force_N:g})
        force change   {force_step_N:.0f} N from tick to tick (limit {c.limits.force_step_N:g}),
                       {within} within 250 ms (limit {c.limits.force_window_N:g})
        condition of J up to {condition_max:.2f} (limit {c.limits.condition:g})
        silence        a leg travels up to {until_braked_m:milli.0f} mm until it rests on its brake,
                       in {braked_ms:.0f} ms: drives.watchdog_ms and engage.brake_close_s
        silence        {no} bound of a leg's travel: the drives keep the last torque until power-off,
                       as they have {no} watchdog set from here
        controlled stop up to {controlled_stop_m:milli.0f} mm, along the path within engage.stop_s
        """,
        figures,
        limit="none" if limit_m_s2 is None else f"{limit_m_s2:g}",
        within="not checked on a path this long" if swings is None else f"{swings.max():.0f} N",
        braked_ms=s.silence and 1e3 * s.silence.T,
        no=None if s.silence else "no",
    )


def operating(r: Report) -> None:
    """Add the demands of speed changes and jogs, and the dead-man key, to the report."""
    s = r.s
    if s.slowed is not None and s.jogged is not None:
        r.figures["speed_change"] = s.slowed._asdict()
        r.figures |= {"jog_change_N": s.jogged.change_N, "jog_rate_m_s": s.jogged.rate_m_s}
        r.add(
            "operating",
            """
            change of speed  adds up to {added_m_s2:.3g} m/s^2 to a leg, {step_N:.3g} N a tick,
                             to {acceleration_m_s2:.3g} m/s^2 and {force_N:.0f} N at most, by {stop}
            jog              changes a force by up to {jog.change_N:.0f} N within 250 ms {window},
                             moves a leg at up to {jog.rate_m_s:.3g} m/s (limit {c.limits.speed_m_s:g})
            """,
            s.slowed._asdict(),
            stop=f"engage.stop_s {s.c.engage.stop_s:g}",
            jog=s.jogged,
            window=f"(limit {s.c.limits.force_window_N:g})",
        )
    deadman_s = s.c.operator.deadman_s
    held = "not needed" if deadman_s is None else f"to be held, sent every {1e3 * deadman_s:g} ms at least"
    r.add("operating", f"key              {held}")


def payload(r: Report) -> None:
    """Add the effect of the payload's ranges on leg forces, limits and safety to the report."""
    s = r.s
    along = carried(s)
    if not along:
        return
    static = np.array([static for static, _ in along])
    tau = np.concatenate([w.tau.ravel() for _, w in along])
    r.figures["payload"] = figures = {
        "static_force_min_N": float(static.min()),
        "static_force_max_N": float(static.max()),
        "force_min_N": float(tau.min()),
        "force_max_N": float(tau.max()),
        "acceleration_m_s2": s.unknown.leg,
    }
    body = next(one for one in s.c.platform.platform.payload if one.ranged)
    r.add(
        f"payload {shown_ranges(body)}",
        """
        static forces  {static_force_min_N:.0f} to {static_force_max_N:.0f} N at home
        leg forces     {force_min_N:.0f} to {force_max_N:.0f} N (limit {c.limits.force_N:g})
        acceleration   up to {acceleration_m_s2:.3g} m/s^2 of a leg under forces for the model's payload,
                       {u.position:.3g} m/s^2, {u.rotation:.3g} rad/s^2 of the pose: rules on
                       encoders, and the monitor, add it to the disturbances of section monitor
        """,
        figures,
        u=s.unknown,
    )


def feedforward(r: Report) -> None:
    """Add source and size of the learned feed-forward, and its effect on the stability monitor."""
    f, settings = r.s.learned, r.s.c.feedforward
    if f is None or settings is None:
        return
    r.figures["feedforward"] = {
        "runs": f.head.run,
        "rms_error_mm": f.head.rms_error_mm,
        "peak_N": f.peak_N,
        "disturbance_m_s2": f.pushed_m_s2,
        "step_N": f.along_N,
        "fade_step_N": f.fading_N,
    }
    r.add(
        "feed-forward",
        """
        learned from   {head.run} run(s), the last one {head.source} with {head.rms_error_mm:.3g} mm rms;
                       {head.first_rms_error_mm:.3g} mm without any
        leg forces     up to {peak_N:.0f} N (limit {limit_N:g}), {start_s:g} to {end_s:g} s of the reference
        changes        by up to {along_N:.3g} N a tick, {fading_N:.3g} N as it fades
        where wrong    a disturbance of up to {pushed_m_s2:.2g} m/s^2 in a leg, a part of {stated}
        """,
        f._asdict(),
        limit_N=settings.limit_N,
        stated=f"monitor.disturbance_m_s2 {r.s.c.monitor.disturbance_m_s2:g}",
    )


def permissions(r: Report) -> None:
    """Add the real-time rights of this machine to the report."""
    with real_time_rights(r.s.c.loop.priority, r.s.c.loop.cpu) as granted:
        r.s.fifo = granted.fifo
    r.figures["real_time"] = {"granted": granted.granted, "missing": granted.missing}
    for key, of in r.figures["real_time"].items():
        r.add("real time on this machine", f"{key}: {', '.join(of) or 'none'}")
