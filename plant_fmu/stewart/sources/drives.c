/* Rules of the drives. Names of states and modes, and the messages, are generated: legs.h. */
#include <stdio.h>

#include "frames.h"

#define NEVER ((int64_t)1 << 62)
#define LONGEST 1152921504606846976.0 /* ns, limit of a watchdog time */
#define STAYS (-1)
#define CURRENT(plant) ((plant)->drives.now_ns)

static const int NEXT[4][5] = {
    [MODE_OFF] = {STAYS, STAYS, STATE_OFF, STATE_OFF, STAYS},
    [MODE_READY] = {STAYS, STATE_READY, STAYS, STATE_READY, STAYS},
    [MODE_RUN] = {STAYS, STAYS, STATE_RUN, STAYS, STAYS},
    [MODE_RESET] = {STAYS, STAYS, STATE_OFF, STATE_OFF, STATE_OFF},
};

static unsigned id_of(const Plant *plant, const Message *m, int leg)
{
    return m->id + (unsigned)plant->v.node_id[leg] - 1;
}

static void report(Plant *plant, int leg)
{
    const Drive *s = &plant->drives.drive[leg];
    unsigned char data[64] = {0}, set_up[64] = {0};
    const int size = CONFIG.of[CRC].start >> 3;
    put(data, STATUS.of[STATE], (uint64_t)s->state);
    put(data, STATUS.of[FAULT], (uint64_t)s->fault);
    if (s->configured) {
        put(set_up, CONFIG.of[WATCHDOG], (uint64_t)rint((double)s->watchdog_ns * 1e-9 / CONFIG.of[WATCHDOG].scale));
        put(set_up, CONFIG.of[REACTION], (uint64_t)s->reaction);
        put(set_up, CONFIG.of[LEG], (uint64_t)leg + 1);
        put(set_up, CONFIG.of[VERSION], LEGS_VERSION);
        spread(set_up + size, (uint64_t)rint(plant->v.drive_force_limit * 1e3), 4);
        put(data, STATUS.of[SETUP], check_of(id_of(plant, &CONFIG, leg), set_up, size + 4, STATUS.of[SETUP].bits));
    }
    transmit(&plant->drives, &STATUS, id_of(plant, &STATUS, leg), data);
}

/* Motion. */

static double grid_ns(const Plant *plant) { return rint((double)plant->steps * (plant->v.internal_step * 1e9)); }

static void enter(Drive *s, int state, int fault)
{
    s->state = state, s->fault = fault;
    if (state != STATE_READY && state != STATE_RUN) s->command = 0.0, s->deadline_ns = NEVER;
}

/* Start, cancel or finish the movement of a brake; a cancelled one leaves the brake as it was. */
static void move_brake(Drive *s, double wanted, double takes_s, int64_t t_ns)
{
    if (s->shut != wanted && s->moved_ns == NEVER) s->moved_ns = t_ns + (int64_t)rint(1e9 * takes_s);
    if (s->shut == wanted) s->moved_ns = NEVER;
    else if (s->moved_ns <= t_ns) s->shut = wanted, s->moved_ns = NEVER;
}

/* Force and brake of each drive from its state. A drive whose brake closes keeps its last force until then. */
static void actuate(Plant *plant, int64_t t_ns)
{
    Values *v = &plant->v;
    Drives *d = &plant->drives;
    d->controls = 0;
    for (int leg = 0; leg < LEGS; leg++) {
        Drive *s = &d->drive[leg];
        double f = s->command;
        const int acting = s->state == STATE_FAULT ? s->acting : REACTION_BRAKE;
        const int opens = s->state == STATE_RUN || acting != REACTION_BRAKE;
        move_brake(s, opens ? 0.0 : 1.0, opens ? v->brake_opening_time : v->brake_closing_time, t_ns);
        if (!opens && s->state != STATE_READY && s->shut == 0.0) f = s->kept;
        if (acting == REACTION_DAMP || acting == REACTION_HOLD) {
            d->controls = 1;
            f = -v->drive_damping * v->rate[leg];
            if (acting == REACTION_HOLD) f -= v->drive_stiffness * (v->length[leg] - s->held);
        }
        if (!(f >= -v->drive_force_limit && f <= v->drive_force_limit))
            f = f > 0.0 ? v->drive_force_limit : -v->drive_force_limit;
        s->kept = s->force = f;
    }
}

/* Advance the plant to its grid point nearest to `t_ns`. */
static int move_to(Plant *plant, int64_t t_ns, char *why)
{
    const double h = plant->v.internal_step;
    long long steps = (long long)floor((double)t_ns / (h * 1e9) + 0.5) - plant->steps;
    while (steps > 0) {
        const long long count = plant->drives.controls ? 1 : steps;
        if (plant->drives.controls) actuate(plant, (int64_t)grid_ns(plant));
        for (int leg = 0; leg < LEGS; leg++) {
            plant->v.force[leg] = plant->drives.drive[leg].force;
            plant->v.brake[leg] = plant->drives.drive[leg].shut;
        }
        if (plant_step(plant, plant->v.time, (double)count * h, why) != 0) return -1;
        if (plant_refresh(plant, PLACE(length), why) != 0) return -1;
        steps -= count;
    }
    return 0;
}

/* Latch a fault. It stays, except that an emergency stop replaces it. */
static void fail(Plant *plant, int leg, int fault, int64_t t_ns)
{
    Drive *s = &plant->drives.drive[leg];
    const int stops = fault == FAULT_ESTOP;
    int reports = 1;
    if (s->state == STATE_FAULT) {
        reports = stops && s->fault != fault;
        s->acting = REACTION_BRAKE, s->deadline_ns = NEVER;
        if (stops) s->fault = fault;
    } else {
        s->acting = stops || s->state != STATE_RUN ? REACTION_BRAKE : s->reaction;
        s->held = plant->v.length[leg];
        enter(s, STATE_FAULT, fault);
        if (s->acting == REACTION_DAMP || s->acting == REACTION_HOLD)
            s->deadline_ns = t_ns + (int64_t)rint(1e9 * plant->v.brake_after);
    }
    actuate(plant, t_ns);
    if (reports) report(plant, leg);
}

/* Frames of the controller. */

static void answer(Plant *plant, int counter)
{
    const Message *m = &FEEDBACK[(int)plant->v.layout - 1];
    const double dt = ((double)CURRENT(plant) - grid_ns(plant)) * 1e-9, quantum = plant->v.encoder_resolution;
    for (int leg = 0; leg < LEGS; leg++) {
        unsigned char data[64] = {0};
        const double rate = plant->v.rate[leg], at = plant->v.length[leg] + rate * dt;
        put_number(plant, data, m->of[LENGTH], quantum > 0.0 ? rint(at / quantum) * quantum : at);
        put_number(plant, data, m->of[RATE], rate);
        put_number(plant, data, m->of[FORCE], plant->v.applied_force[leg]);
        put(data, m->of[COUNTER], (uint64_t)counter);
        put(data, m->of[STATE], (uint64_t)plant->drives.drive[leg].state);
        transmit(&plant->drives, m, id_of(plant, m, leg), data);
    }
}

static void configure(Plant *plant, int leg, const unsigned char *data)
{
    Drive *s = &plant->drives.drive[leg];
    const uint64_t watchdog = natural(data, CONFIG.of[WATCHDOG]), reaction = natural(data, CONFIG.of[REACTION]);
    if (natural(data, CONFIG.of[VERSION]) != LEGS_VERSION || natural(data, CONFIG.of[LEG]) != (uint64_t)leg + 1) return;
    if (watchdog < 1 || reaction > REACTION_ZERO || s->state == STATE_READY || s->state == STATE_RUN) return;
    s->watchdog_ns = (int64_t)rint((double)watchdog * CONFIG.of[WATCHDOG].scale * 1e9);
    s->reaction = (int)reaction, s->configured = 1;
    if (s->state == STATE_BOOT) enter(s, STATE_OFF, FAULT_NONE);
    report(plant, leg);
}

static void obey(Plant *plant, const Message *m, const unsigned char *data)
{
    Drives *d = &plant->drives;
    const int mode = (int)natural(data, m->of[MODE]), counter = (int)natural(data, m->of[COUNTER]);
    double force[LEGS] = {0};
    int fresh = 0, entered = 0;
    if (mode > MODE_RESET || d->present < 0 || counter != (d->present & ((1 << m->of[COUNTER].bits) - 1))) return;
    for (int leg = 0; leg < LEGS; leg++) {
        const Field f = m->of[FORCE1 + leg];
        if (f.bits == 0) continue;
        force[leg] = number(data, f);
        if (f.bits < 64) force[leg] *= scale_of(plant, f);
        else if (!(force[leg] >= f.low && force[leg] <= f.high)) return;
    }
    for (int leg = 0; leg < LEGS; leg++) {
        Drive *s = &d->drive[leg];
        if (m->of[FORCE1 + leg].bits == 0 || s->counter == counter) continue;
        fresh = 1, s->counter = counter;
        const int next = NEXT[mode][s->state];
        if (next != STAYS) {
            enter(s, s->configured ? next : STATE_BOOT, FAULT_NONE);
            entered |= 1 << leg;
        } else if (s->state == STATE_FAULT && mode == MODE_OFF) s->acting = REACTION_BRAKE;
        if (s->state != STATE_READY && s->state != STATE_RUN) continue;
        s->command = force[leg];
        s->deadline_ns = CURRENT(plant) + (s->watchdog_ns < LONGEST ? s->watchdog_ns : (int64_t)LONGEST);
    }
    if (fresh) actuate(plant, CURRENT(plant));
    for (int leg = 0; leg < LEGS; leg++)
        if (entered >> leg & 1) report(plant, leg);
}

static void hear(Plant *plant, unsigned id, const unsigned char *data, int length)
{
    Drives *d = &plant->drives;
    const Message *commands = COMMAND[(int)plant->v.layout - 1];
    if (id == SYNC.id) {
        const int cycle = intact(&SYNC, id, data, length) ? (int)natural(data, SYNC.of[CYCLE]) : d->present;
        if (cycle != d->present) answer(plant, d->present = cycle);
    } else if (id == ESTOP.id) {
        for (int leg = 0; leg < LEGS; leg++) fail(plant, leg, FAULT_ESTOP, d->now_ns);
    } else if (id == commands[0].id || id == commands[1].id) {
        const Message *m = &commands[id != commands[0].id];
        if (intact(m, id, data, length)) obey(plant, m, data);
    } else {
        for (int leg = 0; leg < LEGS; leg++)
            if (id == id_of(plant, &CONFIG, leg) && intact(&CONFIG, id, data, length)) configure(plant, leg, data);
    }
}

/* Process one operation of valid length; 0 if it is corrupt. Operations about the bus have no effect: the bus repeats frames. */
static int take(Plant *plant, unsigned code, const unsigned char *bytes, size_t length)
{
    static const struct {
        unsigned code, length;
    } IGNORED[] = {{0x20, 12}, {0x30, 12}, {0x31, 15}, {0x40, 10}, {0x40, 13}, {0x41, 9}, {0x42, 8}};
    const size_t header = code == CAN_FD_TRANSMIT ? 17 : 16;
    for (size_t k = 0; k < sizeof IGNORED / sizeof IGNORED[0]; k++)
        if (code == IGNORED[k].code && length == IGNORED[k].length) return 1;
    if ((code != CAN_TRANSMIT && code != CAN_FD_TRANSMIT) || length < header) return 0;
    const size_t size = length - header;
    const unsigned id = (unsigned)whole(bytes + 8, 4), extended = bytes[12], remote = header == 16 && bytes[13];
    const int fits = size <= 8 || (header == 17 && size <= 64 && size % (size > 32 ? 16 : size > 24 ? 8 : 4) == 0);
    if (!fits || whole(bytes + header - 2, 2) != size || extended > 1 || bytes[13] > 1) return 0;
    if ((header == 17 && bytes[14] > 1) || id > (extended ? 0x1FFFFFFFu : 0x7FFu)) return 0;
    if (!extended && !remote) hear(plant, id, bytes + header, (int)size);
    return 1;
}

void drives_receive(Plant *plant, const unsigned char *bytes, size_t size)
{
    while (size > 0) {
        const unsigned code = (unsigned)whole(bytes, size < 4 ? (int)size : 4);
        size_t length = size < 8 ? 0 : (size_t)whole(bytes + 4, 4);
        const int readable = length >= 8 && length <= size;
        if (!readable) length = size;
        if (code != FORMAT_ERROR && !(readable && take(plant, code, bytes, length))) { /* no answer to an answer */
            unsigned char *at = operation(&plant->drives, FORMAT_ERROR, 10 + length);
            if (at) {
                spread(at + 8, length, 2);
                memcpy(at + 10, bytes, length);
            }
        }
        bytes += length, size -= length;
    }
}

/* Time. */

static int64_t beat_ns(const Plant *plant)
{
    const double share = 1e9 * plant->v.heartbeat / LEGS;
    return share > 0.0 ? (int64_t)rint((double)plant->drives.beats * share) : NEVER;
}

/* End of the earliest watchdog; brake: of the earliest movement of a brake. */
static int64_t earliest(const Drives *d, int brake)
{
    int64_t t_ns = NEVER;
    for (int leg = 0; leg < LEGS; leg++) {
        const int64_t at = brake ? d->drive[leg].moved_ns : d->drive[leg].deadline_ns;
        if (at < t_ns) t_ns = at;
    }
    return t_ns;
}

int64_t drives_wait(const Plant *plant)
{
    const Drives *d = &plant->drives;
    const int64_t beat = beat_ns(plant), watchdog = earliest(d, 0) + 1; /* a command at its very end is in time */
    const int64_t next = d->size > 0 ? d->now_ns : beat < watchdog ? beat : watchdog;
    return next >= NEVER ? -1 : next - d->now_ns;
}

static int advance(Plant *plant, int64_t until_ns, char *why)
{
    Drives *d = &plant->drives;
    for (;;) {
        const int64_t watchdog = earliest(d, 0), brake = earliest(d, 1), beat = beat_ns(plant);
        const int64_t other = brake < beat ? brake : beat;
        if (watchdog < until_ns && watchdog <= other) {
            if (move_to(plant, watchdog, why) != 0) return -1;
            for (int leg = 0; leg < LEGS; leg++)
                if (d->drive[leg].deadline_ns <= watchdog) fail(plant, leg, FAULT_WATCHDOG, watchdog);
        } else if (other > until_ns) {
            d->now_ns = until_ns;
            return move_to(plant, until_ns, why);
        } else if (other == brake) {
            if (move_to(plant, brake, why) != 0) return -1;
            actuate(plant, brake);
        } else report(plant, (int)(d->beats++ % LEGS));
    }
}

int drives_start(Plant *plant, char *why)
{
    Drives *d = &plant->drives;
    const Values *v = &plant->v;
    memset(d, 0, sizeof *d);
    d->present = -1, d->event_mode = 1;
    for (int leg = 0; leg < LEGS; leg++) {
        Drive *s = &d->drive[leg];
        s->counter = -1, s->deadline_ns = s->moved_ns = NEVER, s->shut = 1.0;
    }
    configure_bus(d, 1, (uint64_t)v->bitrate, 4);
    configure_bus(d, 2, (uint64_t)v->data_bitrate, 4);
    configure_bus(d, 4, 1, 1); /* the bus keeps a frame that lost arbitration */
    return plant_refresh(plant, PLACE(length), why) != 0 ? -1 : advance(plant, 0, why);
}

int drives_step(Plant *plant, double time, double dt, char *why)
{
    Drives *d = &plant->drives;
    const double begin = rint((time - plant->start_time) * 1e9), end = rint((time + dt - plant->start_time) * 1e9);
    if (!(fabs(begin - (double)d->now_ns) <= 1.0 && end >= begin && end < 1e18)) {
        snprintf(why, REASON_SIZE, "a step of %.12g s from %.12g s: the drives are at %.12g s", dt, time,
                 plant->start_time + (double)d->now_ns * 1e-9);
        return -1;
    }
    const int64_t until_ns = (int64_t)end > d->now_ns ? (int64_t)end : d->now_ns;
    d->event_mode = 0; /* an importer without event mode starts in step mode */
    const int failed = advance(plant, until_ns, why);
    plant->v.time = time + dt;
    return failed;
}
