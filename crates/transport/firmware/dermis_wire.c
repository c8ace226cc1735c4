/* SPDX-License-Identifier: Apache-2.0 OR MIT */
#include "dermis_wire.h"

/* Stuffs bytes as they come: `code` is where the length of the current block goes once it is known. */
typedef struct {
    uint8_t *out;
    size_t len;
    size_t code;
    uint8_t run;
    uint16_t crc;
} stuffer;

static uint16_t crc_byte(uint16_t crc, uint8_t byte)
{
    int bit;
    crc = (uint16_t)(crc ^ ((uint16_t)byte << 8));
    for (bit = 0; bit < 8; bit++) {
        crc = (uint16_t)((crc & 0x8000u) ? ((uint16_t)(crc << 1) ^ 0x1021u) : (uint16_t)(crc << 1));
    }
    return crc;
}

uint16_t dermis_crc16(uint16_t crc, const uint8_t *bytes, size_t len)
{
    size_t i;
    for (i = 0; i < len; i++) {
        crc = crc_byte(crc, bytes[i]);
    }
    return crc;
}

static void open_block(stuffer *s)
{
    s->code = s->len++;
    s->run = 1;
}

static void put(stuffer *s, uint8_t byte)
{
    s->crc = crc_byte(s->crc, byte);
    /* A full block is closed only when another byte follows it. */
    if (s->run == 0xFF) {
        s->out[s->code] = 0xFF;
        open_block(s);
    }
    if (byte == 0) {
        s->out[s->code] = s->run;
        open_block(s);
    } else {
        s->out[s->len++] = byte;
        s->run++;
    }
}

static void put_le(stuffer *s, uint64_t value, int bytes)
{
    int i;
    for (i = 0; i < bytes; i++) {
        put(s, (uint8_t)(value >> (8 * i)));
    }
}

static void begin(stuffer *s, uint8_t *out, uint8_t format, uint32_t sequence, uint64_t device_time_us,
                  uint16_t channels)
{
    s->out = out;
    s->len = 0;
    s->crc = 0xFFFF;
    open_block(s);
    put(s, DERMIS_WIRE_VERSION);
    put(s, format);
    put_le(s, channels, 2);
    put_le(s, sequence, 4);
    put_le(s, device_time_us, 8);
}

static size_t end(stuffer *s)
{
    put_le(s, s->crc, 2);
    s->out[s->code] = s->run;
    s->out[s->len++] = 0;
    return s->len;
}

static size_t bits_of(uint8_t format)
{
    switch (format) {
    case DERMIS_WIRE_F32:
    case DERMIS_WIRE_I32:
        return 32;
    case DERMIS_WIRE_I16:
    case DERMIS_WIRE_U16:
        return 16;
    case DERMIS_WIRE_U12:
        return 12;
    default:
        return 0;
    }
}

static uint16_t clamp12(uint16_t count)
{
    return count > 0xFFFu ? 0xFFFu : count;
}

/* Puts values[first .. first + count]; `first` is even. */
static void put_values(stuffer *s, uint8_t format, const void *values, size_t first, size_t count)
{
    size_t i;
    for (i = first; i < first + count; i++) {
        switch (format) {
        case DERMIS_WIRE_F32: {
            union {
                float value;
                uint32_t bits;
            } pun;
            pun.value = ((const float *)values)[i];
            put_le(s, pun.bits, 4);
            break;
        }
        case DERMIS_WIRE_I16:
            put_le(s, (uint16_t)((const int16_t *)values)[i], 2);
            break;
        case DERMIS_WIRE_U16:
            put_le(s, ((const uint16_t *)values)[i], 2);
            break;
        case DERMIS_WIRE_I32:
            put_le(s, (uint32_t)((const int32_t *)values)[i], 4);
            break;
        default: {
            /* Two in three bytes; the last of an odd number in two. */
            const uint16_t *counts = (const uint16_t *)values;
            uint32_t both = clamp12(counts[i]);
            if (i + 1 < first + count) {
                both |= (uint32_t)clamp12(counts[i + 1]) << 12;
                put_le(s, both, 3);
                i++;
            } else {
                put_le(s, both, 2);
            }
            break;
        }
        }
    }
}

static size_t encode(uint8_t *out, size_t out_len, uint8_t format, uint32_t sequence, uint64_t device_time_us,
                     const void *values, uint16_t channels)
{
    stuffer s;
    if (channels == 0 || channels > DERMIS_WIRE_MAX_CHANNELS ||
        out_len < DERMIS_WIRE_LINE_LEN(16u + DERMIS_WIRE_PAYLOAD(channels, bits_of(format)) + 2u)) {
        return 0;
    }
    begin(&s, out, format, sequence, device_time_us, channels);
    put_values(&s, format, values, 0, channels);
    return end(&s);
}

size_t dermis_wire_encode_f32(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const float *values, uint16_t channels)
{
    return encode(out, out_len, DERMIS_WIRE_F32, sequence, device_time_us, values, channels);
}

size_t dermis_wire_encode_i16(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const int16_t *values, uint16_t channels)
{
    return encode(out, out_len, DERMIS_WIRE_I16, sequence, device_time_us, values, channels);
}

size_t dermis_wire_encode_u16(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const uint16_t *values, uint16_t channels)
{
    return encode(out, out_len, DERMIS_WIRE_U16, sequence, device_time_us, values, channels);
}

size_t dermis_wire_encode_i32(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const int32_t *values, uint16_t channels)
{
    return encode(out, out_len, DERMIS_WIRE_I32, sequence, device_time_us, values, channels);
}

size_t dermis_wire_encode_u12(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const uint16_t *values, uint16_t channels)
{
    return encode(out, out_len, DERMIS_WIRE_U12, sequence, device_time_us, values, channels);
}

size_t dermis_wire_encode_part(uint8_t *out, size_t out_len, uint8_t format, uint32_t sequence, uint64_t device_time_us,
                               const void *values, uint16_t channels, uint8_t part)
{
    stuffer s;
    size_t bits = bits_of(format), raw, each, parts, first, count;
    if (bits == 0 || channels == 0 || channels > DERMIS_WIRE_MAX_CHANNELS || out_len < DERMIS_WIRE_MIN_DATAGRAM) {
        return 0;
    }
    /* What is left after stuffing, header and CRC; an even number of values, so that each part begins at a byte. */
    raw = (out_len - 2u) * 254u / 255u;
    each = (raw - 22u) * 8u / bits / 2u * 2u;
    parts = (channels + each - 1u) / each;
    if (parts > 255u || part >= parts) {
        return 0;
    }
    first = part * each;
    count = channels - first < each ? channels - first : each;
    begin(&s, out, (uint8_t)(format | DERMIS_WIRE_PART), sequence, device_time_us, channels);
    put_le(&s, first, 2);
    put(&s, part);
    put(&s, (uint8_t)parts);
    put_values(&s, format, values, first, count);
    return end(&s);
}

uint64_t dermis_clock_extend(dermis_clock *clock, uint32_t micros)
{
    if (micros < clock->last) {
        clock->high++;
    }
    clock->last = micros;
    return ((uint64_t)clock->high << 32) | micros;
}
