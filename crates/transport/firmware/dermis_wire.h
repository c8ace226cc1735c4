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

/* [bytes] of a frame before stuffing, for values of `width` bytes each. */
#define DERMIS_WIRE_RAW_LEN(channels, width) (16u + (size_t)(channels) * (width) + 2u)
/* [bytes] that a frame takes on the line at most, with its delimiter. */
#define DERMIS_WIRE_MAX_LEN(channels, width) \
    (DERMIS_WIRE_RAW_LEN(channels, width) + DERMIS_WIRE_RAW_LEN(channels, width) / 254u + 2u)

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
