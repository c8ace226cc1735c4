/* Native wire of dermis, version 1: reference encoder for firmware. See WIRE.md.
 *
 * C99, no heap, no floating-point arithmetic, no libc beyond <stdint.h> and <stddef.h>; one frame on the stack of
 * the caller. Works on big- and little-endian machines.
 *
 * SPDX-License-Identifier: Apache-2.0 OR MIT
 */
#ifndef DERMIS_WIRE_H
#define DERMIS_WIRE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define DERMIS_WIRE_VERSION 1u
#define DERMIS_WIRE_MAX_CHANNELS 4096u

/* Value formats. */
#define DERMIS_WIRE_F32 0u
#define DERMIS_WIRE_I16 1u
#define DERMIS_WIRE_U16 2u
#define DERMIS_WIRE_I32 3u
/* 12-bit counts, given as uint16_t, two in three bytes on the wire; larger ones are sent as 4095. */
#define DERMIS_WIRE_U12 4u
/* Set in the format of a part. */
#define DERMIS_WIRE_PART 0x80u
/* [bytes] of the shortest datagram that frames are split for. */
#define DERMIS_WIRE_MIN_DATAGRAM 64u

/* [bytes] of so many values of so many bits. */
#define DERMIS_WIRE_PAYLOAD(channels, bits) (((size_t)(channels) * (bits) + 7u) / 8u)
/* [bytes] that so many take on the line at most, with the delimiter. */
#define DERMIS_WIRE_LINE_LEN(raw) ((raw) + (raw) / 254u + 2u)
/* [bytes] of a frame before stuffing, for values of `width` bytes each. */
#define DERMIS_WIRE_RAW_LEN(channels, width) (16u + (size_t)(channels) * (width) + 2u)
/* [bytes] that a frame takes on the line at most, with its delimiter. */
#define DERMIS_WIRE_MAX_LEN(channels, width) DERMIS_WIRE_LINE_LEN(DERMIS_WIRE_RAW_LEN(channels, width))
/* The same for 12-bit counts. */
#define DERMIS_WIRE_MAX_LEN_U12(channels) DERMIS_WIRE_LINE_LEN(16u + DERMIS_WIRE_PAYLOAD(channels, 12u) + 2u)

/* Writes one frame with its delimiter to `out` and returns its length [bytes], or 0 where `out` is too small, or
 * `channels` is 0 or above DERMIS_WIRE_MAX_CHANNELS. `device_time_us` is when the values were measured [us], counted
 * from any start, and 0 where the device has no clock. */
size_t dermis_wire_encode_f32(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const float *values, uint16_t channels);
size_t dermis_wire_encode_i16(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const int16_t *values, uint16_t channels);
size_t dermis_wire_encode_u16(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const uint16_t *values, uint16_t channels);
size_t dermis_wire_encode_i32(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const int32_t *values, uint16_t channels);
size_t dermis_wire_encode_u12(uint8_t *out, size_t out_len, uint32_t sequence, uint64_t device_time_us,
                              const uint16_t *values, uint16_t channels);

/* Writes part number `part`, from 0, of a frame that is longer than a datagram of `out_len` bytes, and returns its length
 * [bytes], or 0 where there is no such part, `out_len` is below DERMIS_WIRE_MIN_DATAGRAM, or the frame would have more than 255
 * parts. `values` are those of the whole frame, of the type that dermis_wire_encode_* takes for `format`. Send the parts of a
 * frame one after the other, each in a datagram of its own:
 *
 *     for (part = 0; (n = dermis_wire_encode_part(out, sizeof out, DERMIS_WIRE_U12, sequence, t, values, 784, part)) > 0; part++)
 *         send(out, n);
 */
size_t dermis_wire_encode_part(uint8_t *out, size_t out_len, uint8_t format, uint32_t sequence, uint64_t device_time_us,
                               const void *values, uint16_t channels, uint8_t part);

/* A 32-bit microsecond counter overflows after 71 minutes; this makes 64 bits of it. Start with zeroes and call
 * dermis_clock_extend at least once per overflow, from one context only. */
typedef struct {
    uint32_t last;
    uint32_t high;
} dermis_clock;

uint64_t dermis_clock_extend(dermis_clock *clock, uint32_t micros);

/* CRC-16/IBM-3740 (CRC-16/CCITT-FALSE); start with 0xFFFF. The check value of "123456789" is 0x29B1. */
uint16_t dermis_crc16(uint16_t crc, const uint8_t *bytes, size_t len);

#ifdef __cplusplus
}
#endif

#endif
