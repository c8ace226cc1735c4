// A camera of Video4Linux 2 for tests, without a kernel that has one: preloaded into the program under test, it answers the system calls for one
// file name as a driver would, after include/uapi/linux/videodev2.h. What it sends is a file, at the pace that was set.
//
// CAMERA        the folder: `video` is the camera (any file), `picture` what it sends; while `unplugged` is there, nothing is
// CAMERA_KIND   four letters of its only format [MJPG]
// CAMERA_SIZE   its only size [820x616]
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/timerfd.h>
#include <unistd.h>

enum { BUFFERS = 8, LENGTH = 1 << 20, PAGE = 4096 };

// One camera, opened once at a time. Its file is a timer, which is readable when a picture is due.
static int timer = -1;
static unsigned rate = 30, buffers, next, sequence;
static void *memory[BUFFERS];
static int queued[BUFFERS];

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static const char *in_folder(const char *name) {
    static __thread char path[4096];
    const char *folder = getenv("CAMERA");
    snprintf(path, sizeof path, "%s/%s", folder ? folder : "/nonexistent", name);
    return path;
}

static int unplugged(void) {
    return access(in_folder("unplugged"), F_OK) == 0;
}

static unsigned kind(void) {
    const char *text = getenv("CAMERA_KIND");
    text = text && strlen(text) == 4 ? text : "MJPG";
    return v4l2_fourcc(text[0], text[1], text[2], text[3]);
}

static void size(unsigned *width, unsigned *height) {
    const char *text = getenv("CAMERA_SIZE");
    *width = 820, *height = 616;
    if (text) sscanf(text, "%ux%u", width, height);
}

static int fails(int reason) {
    errno = reason;
    return -1;
}

static void run(int on) {
    struct itimerspec pace = {{0, 0}, {0, 0}};
    if (on) pace.it_value.tv_nsec = pace.it_interval.tv_nsec = 1000000000 / (rate > 1 ? rate : 2);
    timerfd_settime(timer, 0, &pace, NULL);
}

static int dequeue(struct v4l2_buffer *buffer) {
    unsigned long long due;
    if (read(timer, &due, sizeof due) != sizeof due) return fails(EAGAIN);
    for (unsigned tried = 0; tried < buffers; tried++) {
        unsigned i = (next + tried) % buffers;
        if (!queued[i]) continue;
        int file = REAL(open)(in_folder("picture"), O_RDONLY);
        ssize_t length = file < 0 ? 0 : read(file, memory[i], LENGTH);
        if (file >= 0) close(file);
        queued[i] = 0, next = i + 1;
        buffer->index = i, buffer->bytesused = length > 0 ? length : 0, buffer->sequence = sequence++;
        // Every fifth is damaged, as pictures over a bad cable are.
        buffer->flags = sequence % 5 ? 0 : V4L2_BUF_FLAG_ERROR;
        if (sequence % 5 == 0) memset(memory[i], 7, LENGTH);
        return 0;
    }
    return fails(EAGAIN);
}

static int control(unsigned long request, void *argument) {
    unsigned width, height;
    size(&width, &height);
    if (unplugged()) return fails(ENODEV);
    switch (request) {
    case VIDIOC_QUERYCAP: {
        struct v4l2_capability *caps = argument;
        memset(caps, 0, sizeof *caps);
        strcpy((char *)caps->driver, "test"), strcpy((char *)caps->card, "Camera of a test");
        caps->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        caps->capabilities = caps->device_caps | V4L2_CAP_DEVICE_CAPS;
        return 0;
    }
    case VIDIOC_ENUM_FMT: {
        struct v4l2_fmtdesc *format = argument;
        if (format->index > 0) return fails(EINVAL);
        format->pixelformat = kind();
        return 0;
    }
    case VIDIOC_ENUM_FRAMESIZES: {
        struct v4l2_frmsizeenum *found = argument;
        if (found->index > 0) return fails(EINVAL);
        found->type = V4L2_FRMSIZE_TYPE_DISCRETE;
        found->discrete.width = width, found->discrete.height = height;
        return 0;
    }
    case VIDIOC_G_FMT:
    case VIDIOC_S_FMT: {
        struct v4l2_format *format = argument;
        if (format->type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return fails(EINVAL);
        format->fmt.pix.width = width, format->fmt.pix.height = height;
        format->fmt.pix.pixelformat = kind(), format->fmt.pix.field = V4L2_FIELD_NONE;
        format->fmt.pix.sizeimage = LENGTH;
        return 0;
    }
    case VIDIOC_G_PARM:
    case VIDIOC_S_PARM: {
        struct v4l2_fract *interval = &((struct v4l2_streamparm *)argument)->parm.capture.timeperframe;
        if (request == VIDIOC_S_PARM && interval->numerator) rate = interval->denominator / interval->numerator;
        // It has no more than 50 a second.
        if (rate > 50) rate = 50;
        interval->numerator = 1, interval->denominator = rate;
        return 0;
    }
    case VIDIOC_REQBUFS: {
        struct v4l2_requestbuffers *wanted = argument;
        if (wanted->count > BUFFERS) wanted->count = BUFFERS;
        buffers = wanted->count, next = 0;
        memset(queued, 0, sizeof queued);
        return 0;
    }
    case VIDIOC_QUERYBUF: {
        struct v4l2_buffer *buffer = argument;
        if (buffer->index >= buffers) return fails(EINVAL);
        buffer->length = LENGTH, buffer->m.offset = buffer->index * PAGE;
        return 0;
    }
    case VIDIOC_QBUF: {
        struct v4l2_buffer *buffer = argument;
        if (buffer->index >= buffers || queued[buffer->index]) return fails(EINVAL);
        queued[buffer->index] = 1;
        return 0;
    }
    case VIDIOC_DQBUF:
        return dequeue(argument);
    case VIDIOC_STREAMON:
        return run(1), 0;
    case VIDIOC_STREAMOFF:
        memset(queued, 0, sizeof queued);
        return run(0), 0;
    }
    return fails(ENOTTY);
}

static int open_camera(const char *path) {
    if (strcmp(path, in_folder("video")) != 0) return -2;
    if (unplugged()) return fails(ENOENT);
    if (timer >= 0) return fails(EBUSY);
    timer = timerfd_create(CLOCK_MONOTONIC, TFD_CLOEXEC | TFD_NONBLOCK);
    return timer;
}

#define OPEN(name)                                                       \
    int name(const char *path, int flags, ...) {                         \
        int file = open_camera(path);                                    \
        if (file != -2) return file;                                     \
        va_list list;                                                    \
        va_start(list, flags);                                           \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(list, mode_t) : 0; \
        va_end(list);                                                    \
        return REAL(name)(path, flags, mode);                            \
    }
OPEN(open)
OPEN(open64)

long syscall(long number, ...) {
    va_list list;
    va_start(list, number);
    long a[6];
    for (int i = 0; i < 6; i++) a[i] = va_arg(list, long);
    va_end(list);
    if (number == SYS_ioctl && timer >= 0 && (int)a[0] == timer) return control((unsigned long)a[1], (void *)a[2]);
    return REAL(syscall)(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

#define MMAP(name)                                                                                      \
    void *name(void *at, size_t length, int protection, int flags, int file, off_t offset) {           \
        if (timer < 0 || file != timer)                                                                 \
            return REAL(name)(at, length, protection, flags, file, offset);                             \
        unsigned i = offset / PAGE;                                                                     \
        if (i >= buffers) { errno = EINVAL; return MAP_FAILED; }                                        \
        memory[i] = REAL(name)(at, length, protection, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);             \
        return memory[i];                                                                               \
    }
MMAP(mmap)
MMAP(mmap64)

int close(int file) {
    if (timer >= 0 && file == timer) timer = -1;
    return REAL(close)(file);
}
