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

static int begin(stuffer *s, uint8_t *out, size_t out_len, uint8_t format, uint8_t width, uint32_t sequence,
                 uint64_t device_time_us, uint16_t channels)
{
    if (channels == 0 || channels > DERMIS_WIRE_MAX_CHANNELS ||
        out_len < DERMIS_WIRE_MAX_LEN(channels, width)) {
        return 0;
    }
    s->out = out;
    s->len = 0;
    s->crc = 0xFFFF;
    open_block(s);
    put(s, DERMIS_WIRE_VERSION);
    put(s, format);
    put_le(s, channels, 2);
    put_le(s, sequence, 4);
    put_le(s, device_time_us, 8);
    return 1;
}

static size_t end(stuffer *s)
{
    put_le(s, s->crc, 2);
    s->out[s->code] = s->run;
    s->out[s->len++] = 0;
    return s->len;
}

size_t dermis_wire_encode_f32(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const float *values, uint16_t channels)
{
    stuffer s;
    uint16_t i;
    if (!begin(&s, out, out_len, DERMIS_WIRE_F32, 4, sequence, device_time_us, channels)) {
        return 0;
    }
    for (i = 0; i < channels; i++) {
        union {
            float value;
            uint32_t bits;
        } pun;
        pun.value = values[i];
        put_le(&s, pun.bits, 4);
    }
    return end(&s);
}

size_t dermis_wire_encode_i16(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const int16_t *values, uint16_t channels)
{
    stuffer s;
    uint16_t i;
    if (!begin(&s, out, out_len, DERMIS_WIRE_I16, 2, sequence, device_time_us, channels)) {
        return 0;
    }
    for (i = 0; i < channels; i++) {
        put_le(&s, (uint16_t)values[i], 2);
    }
    return end(&s);
}

size_t dermis_wire_encode_u16(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const uint16_t *values, uint16_t channels)
{
    stuffer s;
    uint16_t i;
    if (!begin(&s, out, out_len, DERMIS_WIRE_U16, 2, sequence, device_time_us, channels)) {
        return 0;
    }
    for (i = 0; i < channels; i++) {
        put_le(&s, values[i], 2);
    }
    return end(&s);
}

size_t dermis_wire_encode_i32(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const int32_t *values, uint16_t channels)
{
    stuffer s;
    uint16_t i;
    if (!begin(&s, out, out_len, DERMIS_WIRE_I32, 4, sequence, device_time_us, channels)) {
        return 0;
    }
    for (i = 0; i < channels; i++) {
        put_le(&s, (uint32_t)values[i], 4);
    }
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
