/* Encodes frames that a test asks for on its standard input: format u8, channels u16, sequence u32, time u64, datagram u32,
 * values. Each is answered by a length u32 and the frame; where a datagram has a length, by as many parts as there are, each with
 * its length, and a length of 0. 12-bit counts are requested as 16-bit ones. Numbers are in the order of the host. */
#include <stdio.h>
#include <string.h>

#include "dermis_wire.h"

static int take(void *to, size_t len)
{
    return fread(to, 1, len, stdin) == len;
}

int main(void)
{
    static uint8_t values[4 * DERMIS_WIRE_MAX_CHANNELS];
    static float as_f32[DERMIS_WIRE_MAX_CHANNELS];
    static int16_t as_i16[DERMIS_WIRE_MAX_CHANNELS];
    static uint16_t as_u16[DERMIS_WIRE_MAX_CHANNELS];
    static int32_t as_i32[DERMIS_WIRE_MAX_CHANNELS];
    static uint8_t out[DERMIS_WIRE_MAX_LEN(DERMIS_WIRE_MAX_CHANNELS, 4)];
    uint8_t format;
    while (take(&format, 1)) {
        uint16_t channels;
        uint32_t sequence, datagram, answer;
        uint64_t time_us;
        size_t width = (format == DERMIS_WIRE_F32 || format == DERMIS_WIRE_I32) ? 4 : 2;
        /* No byte more than the frame may need, so that the bound of the header is tested too. */
        size_t room, n = 0;
        if (!take(&channels, 2) || !take(&sequence, 4) || !take(&time_us, 8) || !take(&datagram, 4) ||
            !take(values, channels * width)) {
            return 1;
        }
        if (datagram > 0) {
            uint8_t part = 0;
            const void *given = as_u16;
            memcpy(as_u16, values, width == 2 ? channels * width : 0);
            memcpy(as_i16, values, width == 2 ? channels * width : 0);
            memcpy(as_f32, values, width == 4 ? channels * width : 0);
            memcpy(as_i32, values, width == 4 ? channels * width : 0);
            if (format == DERMIS_WIRE_F32) {
                given = as_f32;
            } else if (format == DERMIS_WIRE_I32) {
                given = as_i32;
            } else if (format == DERMIS_WIRE_I16) {
                given = as_i16;
            }
            do {
                n = dermis_wire_encode_part(out, datagram, format, sequence, time_us, given, channels, part++);
                answer = (uint32_t)n;
                fwrite(&answer, 1, 4, stdout);
                fwrite(out, 1, n, stdout);
            } while (n > 0);
            fflush(stdout);
            continue;
        }
        room = format == DERMIS_WIRE_U12 ? DERMIS_WIRE_MAX_LEN_U12(channels) : DERMIS_WIRE_MAX_LEN(channels, width);
        switch (format) {
        case DERMIS_WIRE_F32:
            memcpy(as_f32, values, channels * width);
            n = dermis_wire_encode_f32(out, room, sequence, time_us, as_f32, channels);
            break;
        case DERMIS_WIRE_I16:
            memcpy(as_i16, values, channels * width);
            n = dermis_wire_encode_i16(out, room, sequence, time_us, as_i16, channels);
            break;
        case DERMIS_WIRE_U16:
            memcpy(as_u16, values, channels * width);
            n = dermis_wire_encode_u16(out, room, sequence, time_us, as_u16, channels);
            break;
        case DERMIS_WIRE_U12:
            memcpy(as_u16, values, channels * width);
            n = dermis_wire_encode_u12(out, room, sequence, time_us, as_u16, channels);
            break;
        default:
            memcpy(as_i32, values, channels * width);
            n = dermis_wire_encode_i32(out, room, sequence, time_us, as_i32, channels);
            break;
        }
        if (n > room) {
            return 2;
        }
        answer = (uint32_t)n;
        fwrite(&answer, 1, 4, stdout);
        fwrite(out, 1, n, stdout);
        fflush(stdout);
    }
    return 0;
}
