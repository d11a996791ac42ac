/* A producer of frames for `lfgpu live ring:FILE`: a ring buffer in shared memory, in C99 or C++11, for POSIX systems.
 *
 *     lfgpu_ring ring;
 *     lfgpu_ring_kind kind = {9, 480, 640, 3, LFGPU_RING_UINT8, 4, 4, positions};
 *     if (lfgpu_ring_create(&ring, "/dev/shm/rig", &kind) != 0) perror("/dev/shm/rig");
 *     for (;;) {
 *         uint8_t *views = (uint8_t *)lfgpu_ring_begin(&ring);    // [n, y, x, c], to be filled
 *         ...
 *         lfgpu_ring_publish(&ring, NULL, time_ns);
 *     }
 *     lfgpu_ring_close(&ring);
 *
 * The producer never waits. A reader takes a frame only if its slot has the number of that frame before and after the
 * copy, so it never gets one that is half old and half new. One thread at a time may use a ring. All numbers are in the
 * byte order of the machine, which must be little endian. docs/live.md has the layout.
 */
#ifndef LFGPU_RING_H
#define LFGPU_RING_H

#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

enum { LFGPU_RING_UINT8 = 1, LFGPU_RING_UINT16 = 2, LFGPU_RING_FLOAT32 = 3 };

/* What all frames have in common. */
typedef struct {
    uint32_t views, height, width; /* n cameras; size of their pictures, pixels */
    uint32_t channels;             /* 1 or 3 */
    uint32_t type;                 /* LFGPU_RING_UINT8 ... */
    uint32_t reference;            /* index of the view whose disparity is estimated */
    uint32_t slots;                /* frames that the ring holds, 3 to 1024 */
    const double *positions;       /* [n][2], (u, v) of each camera in view steps: u to the right, v down */
} lfgpu_ring_kind;

typedef struct {
    uint32_t views, slots;
    uint64_t header_bytes, slot_bytes, views_at, total, frame;
    int file;
    unsigned char *memory;
    char path[1024];
} lfgpu_ring;

static inline uint64_t lfgpu_ring_up(uint64_t value, uint64_t unit) { return (value + unit - 1) / unit * unit; }

static inline void lfgpu_ring_put(unsigned char *place, const void *value, size_t bytes) { memcpy(place, value, bytes); }

/* Make the file and its memory. 0, or -1 with errno: EBUSY if another producer writes to it, EINVAL for a wrong kind. */
static inline int lfgpu_ring_create(lfgpu_ring *ring, const char *path, const lfgpu_ring_kind *kind)
{
    static const uint64_t bytes_of[] = {0, 1, 2, 4};
    char temporary[1100];
    int old;
    uint32_t one = 1, zero = 0, header;
    if (kind->views < 2 || kind->height == 0 || kind->width == 0 || (kind->channels != 1 && kind->channels != 3)
        || kind->type < 1 || kind->type > 3 || kind->reference >= kind->views || kind->slots < 3 || kind->slots > 1024
        || strlen(path) >= sizeof ring->path) {
        errno = EINVAL;
        return -1;
    }
    ring->views = kind->views;
    ring->slots = kind->slots;
    ring->frame = 0;
    ring->memory = NULL;
    ring->header_bytes = lfgpu_ring_up(64 + 16 * (uint64_t)kind->views, 4096);
    ring->views_at = lfgpu_ring_up(16 + (uint64_t)kind->views, 64);
    ring->slot_bytes = lfgpu_ring_up(
        ring->views_at + (uint64_t)kind->views * kind->height * kind->width * kind->channels * bytes_of[kind->type], 4096
    );
    ring->total = ring->header_bytes + kind->slots * ring->slot_bytes;
    strcpy(ring->path, path);
    old = open(path, O_RDONLY);
    if (old >= 0) {
        int tries, locked = -1;
        for (tries = 0; tries < 20 && locked != 0; ++tries) { /* readers lock it for a moment to see who is there */
            locked = flock(old, LOCK_EX | LOCK_NB);
            if (locked != 0) usleep(500);
        }
        close(old);
        if (locked != 0) {
            errno = EBUSY;
            return -1;
        }
    }
    snprintf(temporary, sizeof temporary, "%s.%ld.new", path, (long)getpid());
    ring->file = open(temporary, O_RDWR | O_CREAT | O_EXCL, 0600);
    if (ring->file < 0) return -1;
    if (ftruncate(ring->file, (off_t)ring->total) == 0) {
#ifdef __linux__
        int full = posix_fallocate(ring->file, 0, (off_t)ring->total); /* a full memory is found now, not by a signal */
        if (full != 0) {
            errno = full;
            goto failed;
        }
#endif
        void *memory = mmap(NULL, ring->total, PROT_READ | PROT_WRITE, MAP_SHARED, ring->file, 0);
        if (memory != MAP_FAILED) ring->memory = (unsigned char *)memory;
    }
    if (ring->memory == NULL) goto failed;
    header = (uint32_t)ring->header_bytes;
    lfgpu_ring_put(ring->memory, "LFGPURNG", 8);
    lfgpu_ring_put(ring->memory + 8, &one, 4);
    lfgpu_ring_put(ring->memory + 12, &header, 4);
    lfgpu_ring_put(ring->memory + 16, &ring->slot_bytes, 8);
    lfgpu_ring_put(ring->memory + 24, &kind->slots, 4);
    lfgpu_ring_put(ring->memory + 28, &kind->views, 4);
    lfgpu_ring_put(ring->memory + 32, &kind->height, 4);
    lfgpu_ring_put(ring->memory + 36, &kind->width, 4);
    lfgpu_ring_put(ring->memory + 40, &kind->channels, 4);
    lfgpu_ring_put(ring->memory + 44, &kind->type, 4);
    lfgpu_ring_put(ring->memory + 48, &kind->reference, 4);
    lfgpu_ring_put(ring->memory + 52, &zero, 4);
    lfgpu_ring_put(ring->memory + 64, kind->positions, 16 * (size_t)kind->views);
    if (flock(ring->file, LOCK_EX | LOCK_NB) != 0 || rename(temporary, path) != 0) goto failed;
    return 0;
failed:
    old = errno;
    if (ring->memory != NULL) munmap(ring->memory, ring->total);
    close(ring->file);
    unlink(temporary);
    errno = old;
    return -1;
}

static inline unsigned char *lfgpu_ring_slot(lfgpu_ring *ring)
{
    return ring->memory + ring->header_bytes + (ring->frame % ring->slots) * ring->slot_bytes;
}

/* The views [n, y, x, c] of the next frame, to be filled before `lfgpu_ring_publish`. */
static inline void *lfgpu_ring_begin(lfgpu_ring *ring)
{
    unsigned char *slot = lfgpu_ring_slot(ring);
    __atomic_store_n((uint64_t *)(void *)slot, 2 * (ring->frame + 1) - 1, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    return slot + ring->views_at;
}

/* Hand over the frame that was begun. `valid` has a byte for each camera, 0 for those without a picture; NULL: all have
 * one. `time_ns` is when it was taken, nanoseconds. Returns the number of the frame, from 1. */
static inline uint64_t lfgpu_ring_publish(lfgpu_ring *ring, const uint8_t *valid, uint64_t time_ns)
{
    unsigned char *slot = lfgpu_ring_slot(ring);
    if (valid != NULL)
        memcpy(slot + 16, valid, ring->views);
    else
        memset(slot + 16, 1, ring->views);
    lfgpu_ring_put(slot + 8, &time_ns, 8);
    ring->frame += 1;
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    __atomic_store_n((uint64_t *)(void *)slot, 2 * ring->frame, __ATOMIC_RELEASE);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    __atomic_store_n((uint64_t *)(void *)(ring->memory + 56), ring->frame, __ATOMIC_RELEASE);
    return ring->frame;
}

/* Tell readers that there are no more frames, and remove the file. */
static inline void lfgpu_ring_close(lfgpu_ring *ring)
{
    struct stat named, own;
    uint32_t one = 1;
    lfgpu_ring_put(ring->memory + 52, &one, 4);
    if (stat(ring->path, &named) == 0 && fstat(ring->file, &own) == 0 && named.st_ino == own.st_ino
        && named.st_dev == own.st_dev)
        unlink(ring->path);
    munmap(ring->memory, ring->total);
    close(ring->file);
}

#endif
