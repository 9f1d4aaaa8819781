/* Fields of messages, their checksums, and the bus operations to send. Part of drives.c. */
#ifndef STEWART_FRAMES_H
#define STEWART_FRAMES_H

#include <math.h>
#include <string.h>

#include "legs.h"
#include "plant.h"

/* Operation codes of FMI-LS-BUS 1.0. */
enum { FORMAT_ERROR = 0x01, CAN_TRANSMIT = 0x10, CAN_FD_TRANSMIT, CONFIGURATION = 0x40 };

/* Fields: little endian, those of 64 bits are float64. */

static uint64_t whole(const unsigned char *bytes, int count)
{
    uint64_t value = 0;
    while (count-- > 0) value = value << 8 | bytes[count];
    return value;
}

static void spread(unsigned char *bytes, uint64_t value, int count)
{
    for (int k = 0; k < count; k++) bytes[k] |= (unsigned char)(value >> 8 * k);
}

static uint64_t natural(const unsigned char *data, Field f)
{
    const int shift = f.start & 7;
    const uint64_t value = whole(data + (f.start >> 3), (shift + f.bits + 7) >> 3) >> shift;
    return f.bits == 64 ? value : value & (((uint64_t)1 << f.bits) - 1);
}

static double number(const unsigned char *data, Field f)
{
    const uint64_t raw = natural(data, f);
    double value;
    if (f.bits == 64) memcpy(&value, &raw, sizeof value);
    else value = (double)((int64_t)raw - (int64_t)((raw >> (f.bits - 1)) << f.bits));
    return value;
}

/* Write into a field that is 0. */
static void put(unsigned char *data, Field f, uint64_t value)
{
    const int shift = f.start & 7;
    if (f.bits < 64) value = (value & (((uint64_t)1 << f.bits) - 1)) << shift;
    spread(data + (f.start >> 3), value, (shift + f.bits + 7) >> 3);
}

static double scale_of(const Plant *plant, Field f)
{
    return f.of_rated ? f.scale * (plant->v.drive_force_limit / 100.0) : f.scale;
}

/* A value, saturated to the field's range. */
static void put_number(const Plant *plant, unsigned char *data, Field f, double value)
{
    const double share = f.of_rated ? plant->v.drive_force_limit / 100.0 : 1.0;
    const double low = f.low * share, high = f.high * share;
    uint64_t raw;
    if (f.bits == 0) return;
    value = value < low ? low : value > high ? high : value;
    if (f.bits == 64) memcpy(&raw, &value, sizeof raw);
    else raw = (uint64_t)(int64_t)rint(value / scale_of(plant, f));
    put(data, f, raw);
}

static unsigned check_of(unsigned id, const unsigned char *data, int size, int bits)
{
    const unsigned top = 1u << (bits - 1), mask = 2 * top - 1, polynomial = bits == 8 ? POLYNOMIAL : POLYNOMIAL_16;
    unsigned r = mask;
    for (int k = -2; k < size; k++) {
        r ^= (k < 0 ? id >> 8 * (k + 2) & 0xFF : data[k]) << (bits - 8);
        for (int bit = 0; bit < 8; bit++) r = (r & top ? r << 1 ^ polynomial : r << 1) & mask;
    }
    return bits == 8 ? r ^ 0xFF : r;
}

/* Length and checksum are right, and the bytes after the checksum are 0. */
static int intact(const Message *m, unsigned id, const unsigned char *data, int length)
{
    const Field f = m->of[CRC];
    if (length != m->length || check_of(id, data, f.start >> 3, f.bits) != natural(data, f)) return 0;
    for (int k = (f.start + f.bits) >> 3; k < length; k++)
        if (data[k]) return 0;
    return 1;
}

/* Bus operations. */

/* A new operation of `length` bytes with its header, the rest 0; NULL if there is no room. */
static unsigned char *operation(Drives *d, unsigned code, size_t length)
{
    unsigned char *bytes = d->operations + d->size;
    if (length > BUS_BYTES - d->size) return NULL;
    memset(bytes, 0, length);
    spread(bytes, code, 4);
    spread(bytes + 4, length, 4);
    d->size += length;
    return bytes;
}

static void configure_bus(Drives *d, int kind, uint64_t value, int bytes)
{
    unsigned char *at = operation(d, CONFIGURATION, 9 + (size_t)bytes);
    at[8] = (unsigned char)kind;
    spread(at + 9, value, bytes);
}

/* Send a frame; its checksum is filled in. */
static void transmit(Drives *d, const Message *m, unsigned id, unsigned char *data)
{
    const Field f = m->of[CRC];
    const size_t header = m->fd ? 17 : 16;
    unsigned char *at = operation(d, m->fd ? CAN_FD_TRANSMIT : CAN_TRANSMIT, header + (size_t)m->length);
    if (!at) return;
    put(data, f, check_of(id, data, f.start >> 3, f.bits));
    spread(at + 8, id, 4);
    if (m->fd) at[13] = (unsigned char)m->brs;
    spread(at + header - 2, (uint64_t)m->length, 2);
    memcpy(at + header, data, (size_t)m->length);
}

#endif
