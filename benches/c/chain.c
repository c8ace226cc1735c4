/* What a C programmer writes in place of a node, and nothing else: frames of a line are decoded and checked, a zero is taken and
 * subtracted, a small network runs in plain loops, and the answer goes to a socket. No channel health, no drift, no clock mapping,
 * no identities, no diagnostics, no ROS.
 *
 *     chain LINE SOCKET     reads the line, sends one datagram a frame to the Unix socket
 *     chain                 answers readings from standard input, for a check of the network
 *
 * `network.h` is generated of the skin and the bundle's graph: CHANNELS, ANSWERS, THRESHOLD, `noise`, `network()`, and how readings
 * and answers are scaled.
 */
#include <fcntl.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "network.h"

#define ZERO_FRAMES 200
#define HEADER 16
#define FRAME (HEADER + 4 * CHANNELS + 2)

enum { OK = 0, UNCALIBRATED = 3 };

/* As the subscriber of the measurement reads it. */
struct __attribute__((packed)) answer {
    uint64_t sequence;
    uint8_t status;
    uint8_t contacts;
    float values[ANSWERS];
};

static uint16_t crc_table[256];

static void make_crc_table(void) {
    for (int i = 0; i < 256; i++) {
        uint16_t c = (uint16_t)(i << 8);
        for (int bit = 0; bit < 8; bit++) c = (uint16_t)(c & 0x8000 ? c << 1 ^ 0x1021 : c << 1);
        crc_table[i] = c;
    }
}

static uint16_t crc(const uint8_t *bytes, size_t n) {
    uint16_t c = 0xffff;
    for (size_t i = 0; i < n; i++) c = (uint16_t)(c << 8 ^ crc_table[(c >> 8 ^ bytes[i]) & 0xff]);
    return c;
}

/* COBS; the number of bytes, or 0 where they are no frame. */
static size_t unstuff(const uint8_t *in, size_t n, uint8_t *out, size_t room) {
    size_t at = 0, to = 0;
    while (at < n) {
        size_t run = in[at++];
        if (run == 0 || at + run - 1 > n || to + run - 1 > room) return 0;
        memcpy(out + to, in + at, run - 1);
        at += run - 1;
        to += run - 1;
        if (run < 255 && at < n) {
            if (to == room) return 0;
            out[to++] = 0;
        }
    }
    return to;
}

static int socket_to(const char *path) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    strncpy(address.sun_path, path, sizeof address.sun_path - 1);
    int s = socket(AF_UNIX, SOCK_DGRAM, 0);
    if (s < 0 || connect(s, (struct sockaddr *)&address, sizeof address) != 0) {
        perror(path);
        exit(1);
    }
    return s;
}

static int line_at(const char *path) {
    int line = open(path, O_RDONLY | O_NOCTTY);
    struct termios settings;
    if (line < 0 || tcgetattr(line, &settings) != 0) {
        perror(path);
        exit(1);
    }
    cfmakeraw(&settings);
    tcsetattr(line, TCSANOW, &settings);
    return line;
}

static void answer_of(const float *signal, float *values) {
    float input[CHANNELS];
    for (int i = 0; i < CHANNELS; i++) input[i] = (signal[i] - input_mean[i]) / input_scale[i];
    network(input, values);
    for (int i = 0; i < ANSWERS; i++) values[i] = values[i] * output_scale[i] + output_mean[i];
}

int main(int count, char **arguments) {
    if (count != 3) {
        float signal[CHANNELS], values[ANSWERS];
        while (fread(signal, sizeof signal, 1, stdin) == 1) {
            answer_of(signal, values);
            fwrite(values, sizeof values, 1, stdout);
        }
        return 0;
    }
    make_crc_table();
    int out = socket_to(arguments[2]), line = line_at(arguments[1]);
    static uint8_t waiting[1 << 16];
    size_t have = 0;
    int taken = 0;
    float sum[CHANNELS] = {0}, zero[CHANNELS] = {0};
    for (;;) {
        ssize_t got = read(line, waiting + have, sizeof waiting - have);
        if (got <= 0) return 0;
        have += (size_t)got;
        size_t begin = 0;
        uint8_t *end;
        while ((end = memchr(waiting + begin, 0, have - begin)) != NULL) {
            uint8_t frame[FRAME];
            size_t n = unstuff(waiting + begin, (size_t)(end - waiting) - begin, frame, sizeof frame);
            begin = (size_t)(end - waiting) + 1;
            uint16_t channels, check;
            uint32_t sequence;
            if (n != FRAME || frame[0] != 1 || frame[1] != 0) continue;
            memcpy(&channels, frame + 2, 2);
            memcpy(&sequence, frame + 4, 4);
            memcpy(&check, frame + n - 2, 2);
            if (channels != CHANNELS || check != crc(frame, n - 2)) continue;
            float reading[CHANNELS];
            memcpy(reading, frame + HEADER, sizeof reading);
            struct answer answer = {.sequence = sequence, .status = OK};
            if (taken < ZERO_FRAMES) {
                taken++;
                for (int i = 0; i < CHANNELS; i++) {
                    sum[i] += reading[i];
                    zero[i] = sum[i] / (float)taken;
                }
                answer.status = UNCALIBRATED;
            } else {
                float signal[CHANNELS], square = 0, values[ANSWERS];
                for (int i = 0; i < CHANNELS; i++) {
                    signal[i] = reading[i] - zero[i];
                    square += signal[i] / noise[i] * (signal[i] / noise[i]);
                }
                if (sqrtf(square / CHANNELS) > THRESHOLD) {
                    answer_of(signal, values);
                    answer.contacts = 1;
                    memcpy(answer.values, values, sizeof values);
                }
            }
            if (send(out, &answer, sizeof answer, 0) < 0) return 0;
        }
        memmove(waiting, waiting + begin, have - begin);
        have -= begin;
        if (have == sizeof waiting) have = 0;
    }
}
