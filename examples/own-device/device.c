/* A device of 25 barometers: ./device PATH [FRAMES] writes frames to a serial line, or to any other file.
 *
 *   cc -O2 -I crates/transport/firmware -o device examples/own-device/device.c crates/transport/firmware/dermis_wire.c
 */
#define _POSIX_C_SOURCE 200809L

#include "dermis_wire.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#define CHANNELS 25 /* of launch/skins/baro-grid.toml */
#define PERIOD_NS 10000000L

static uint64_t micros(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

/* [Pa]: 100 frames untouched, then 100 frames pressed above the middle, and so on. */
static void measure(uint32_t sequence, float values[CHANNELS])
{
    const int pressed = sequence / 100u % 2u == 1u;
    for (int i = 0; i < CHANNELS; i++) {
        const int x = i % 5 - 2, y = i / 5 - 2;
        values[i] = pressed ? 2000.0f / (float)((1 + x * x + y * y) * (1 + x * x + y * y)) : 0.0f;
    }
}

int main(int count, char **arguments)
{
    if (count < 2) {
        fprintf(stderr, "usage: %s PATH [FRAMES]\n", arguments[0]);
        return 1;
    }
    const int line = open(arguments[1], O_WRONLY | O_NOCTTY | O_CREAT, 0644);
    if (line < 0) {
        perror(arguments[1]);
        return 1;
    }
    const long frames = count > 2 ? atol(arguments[2]) : -1;
    const uint8_t start = 0; /* A frame that was cut off before a reset ends here. */
    if (write(line, &start, 1) != 1) {
        perror("write");
        return 1;
    }
    for (uint32_t sequence = 0; frames < 0 || sequence < (uint32_t)frames; sequence++) {
        uint8_t bytes[DERMIS_WIRE_MAX_LEN(CHANNELS, 4)];
        float values[CHANNELS];
        const uint64_t now = micros(); /* when conversion starts */
        measure(sequence, values);
        const size_t length = dermis_wire_encode_f32(bytes, sizeof bytes, sequence, now, values, CHANNELS);
        if (write(line, bytes, length) != (ssize_t)length) {
            perror("write");
            return 1;
        }
        if (frames < 0) {
            const struct timespec wait = { 0, PERIOD_NS };
            nanosleep(&wait, NULL);
        }
    }
    close(line);
    return 0;
}
