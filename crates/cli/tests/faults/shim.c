/* Loaded before the C library: counts every call that changes a file, and lets one of them go wrong.
 *
 * FAULT_AT    which call, counted from 1 over all threads; 0 for none
 * FAULT_MODE  kill: the process is killed before the call; half: a write is killed half-way;
 *             full: from this call on the disk is full
 *             unlinked: the file system has no hard links, and nothing else goes wrong
 *             hold: the process waits before the call, see below
 * FAULT_COUNT a file that gets the number of calls when the process ends by itself
 *
 * What goes to the terminal (descriptors up to 2) does not count.
 *
 * In mode hold, calls that open, list, lock, remove or name a file whose path contains FAULT_PATH are counted instead.
 * Before call FAULT_AT the file FAULT_HELD is made; the process goes on when it is removed.
 * Before it waits for a lock it makes the file FAULT_WAITS. */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static long at, seen;
static enum { KILL, HALF, FULL, UNLINKED, HOLD } mode;

__attribute__((constructor)) static void begin(void) {
    const char *number = getenv("FAULT_AT"), *name = getenv("FAULT_MODE");
    at = number ? atol(number) : 0;
    const char *names[] = {"kill", "half", "full", "unlinked", "hold"};
    for (int k = 0; name && k < 5; k++)
        if (!strcmp(name, names[k])) mode = k;
    unsetenv("LD_PRELOAD"); /* what this process starts is left in peace */
}

__attribute__((destructor)) static void end(void) {
    const char *path = getenv("FAULT_COUNT");
    long count = seen;
    FILE *file = path ? fopen(path, "w") : NULL;
    if (file) {
        fprintf(file, "%ld\n", count);
        fclose(file);
    }
}

/* Counts a call; whether it has to fail for want of space. `half` bytes of a write are possible before that. */
static int fails(void) {
    long now = __atomic_add_fetch(&seen, 1, __ATOMIC_SEQ_CST);
    if (at && now == at && mode < FULL) kill(getpid(), SIGKILL);
    if (at && now >= at && mode == FULL) {
        errno = ENOSPC;
        return 1;
    }
    return 0;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define CALL(type, name, parameters, ...)                                                                              \
    type name parameters { return fails() ? -1 : REAL(name)(__VA_ARGS__); }
#define NAMES(type, name, parameters, path, ...)                                                                       \
    type name parameters {                                                                                             \
        holds(path);                                                                                                   \
        return fails() ? -1 : REAL(name)(__VA_ARGS__);                                                                 \
    }

/* Makes the file that the variable `name` of the environment names; its path. */
static const char *mark(const char *name) {
    const char *path = getenv(name);
    int file = path ? REAL(open)(path, O_CREAT | O_WRONLY, 0600) : -1;
    if (file >= 0) close(file);
    return path;
}

/* Counts a call on `path` in mode hold, and waits if it is the one. */
static void holds(const char *path) {
    static long passed;
    const char *part = getenv("FAULT_PATH");
    if (mode != HOLD || !part) return;
    /* A path through an open folder is that of the folder and a name. */
    char folder[32], whole[8192];
    const char *name = strncmp(path, "/proc/self/fd/", 14) ? NULL : strchr(path + 14, '/');
    if (name && name - path < (long)sizeof folder) {
        snprintf(folder, sizeof folder, "%.*s", (int)(name - path), path);
        ssize_t length = readlink(folder, whole, 4096);
        snprintf(whole + (length > 0 ? length : 0), 4096, "%s", name);
        path = whole;
    }
    if (!strstr(path, part) || __atomic_add_fetch(&passed, 1, __ATOMIC_SEQ_CST) != at) return;
    const char *held = mark("FAULT_HELD");
    while (held && !access(held, F_OK)) usleep(1000);
}

/* A write that is due writes its first half: then the process is killed, or the disk is full. */
static ssize_t first_half(int fd, const void *bytes, size_t length, ssize_t (*real)(int, const void *, size_t)) {
    if ((mode == HALF || mode == FULL) && at && length > 1 && __atomic_load_n(&seen, __ATOMIC_SEQ_CST) + 1 == at) {
        __atomic_add_fetch(&seen, 1, __ATOMIC_SEQ_CST);
        ssize_t written = real(fd, bytes, length / 2);
        if (mode == HALF) kill(getpid(), SIGKILL);
        return written;
    }
    return fails() ? -1 : real(fd, bytes, length);
}

ssize_t write(int fd, const void *bytes, size_t length) {
    ssize_t (*real)(int, const void *, size_t) = REAL(write);
    return fd <= 2 ? real(fd, bytes, length) : first_half(fd, bytes, length, real);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    return fd > 2 && fails() ? -1 : REAL(writev)(fd, parts, count);
}

CALL(ssize_t, pwrite, (int fd, const void *bytes, size_t length, off_t place), fd, bytes, length, place)
CALL(ssize_t, pwrite64, (int fd, const void *bytes, size_t length, off64_t place), fd, bytes, length, place)
CALL(int, fsync, (int fd), fd)
CALL(int, fdatasync, (int fd), fd)
NAMES(int, rename, (const char *from, const char *to), to, from, to)
NAMES(int, mkdir, (const char *path, mode_t rights), path, path, rights)
CALL(int, ftruncate, (int fd, off_t length), fd, length)
CALL(int, ftruncate64, (int fd, off64_t length), fd, length)
CALL(ssize_t, copy_file_range, (int from, off64_t *a, int to, off64_t *b, size_t length, unsigned flags), from, a, to, b, length, flags)

int linkat(int a, const char *from, int b, const char *to, int flags) {
    holds(to);
    if (mode == UNLINKED) {
        errno = EPERM;
        return -1;
    }
    return fails() ? -1 : REAL(linkat)(a, from, b, to, flags);
}

int flock(int fd, int what) {
    char name[32], path[4096] = "";
    snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
    if (mode == HOLD && readlink(name, path, sizeof path - 1) > 0) {
        holds(path);
        if (!(what & (LOCK_NB | LOCK_UN))) mark("FAULT_WAITS");
    }
    return REAL(flock)(fd, what);
}

DIR *opendir(const char *path) {
    holds(path);
    return REAL(opendir)(path);
}

/* A full disk lets files go. */
#define REMOVES(name, parameters, ...)                                                                                 \
    int name parameters {                                                                                              \
        holds(path);                                                                                                   \
        fails();                                                                                                       \
        return REAL(name)(__VA_ARGS__);                                                                                \
    }
REMOVES(unlink, (const char *path), path)
REMOVES(rmdir, (const char *path), path)
REMOVES(unlinkat, (int folder, const char *path, int flags), folder, path, flags)

/* Only an opening that may make a file, or empties one, changes anything. */
#define CHANGES(flags) ((flags) & (O_CREAT | O_TRUNC))
#define RIGHTS(flags)                                                                                                  \
    mode_t rights = 0;                                                                                                 \
    if ((flags) & (O_CREAT | O_TMPFILE)) {                                                                             \
        va_list more;                                                                                                  \
        va_start(more, flags);                                                                                         \
        rights = va_arg(more, mode_t);                                                                                 \
        va_end(more);                                                                                                  \
    }
#define OPENS(name)                                                                                                    \
    int name(const char *path, int flags, ...) {                                                                       \
        RIGHTS(flags)                                                                                                  \
        holds(path);                                                                                                   \
        return CHANGES(flags) && fails() ? -1 : REAL(name)(path, flags, rights);                                       \
    }
#define OPENS_AT(name)                                                                                                 \
    int name(int folder, const char *path, int flags, ...) {                                                           \
        RIGHTS(flags)                                                                                                  \
        holds(path);                                                                                                   \
        return CHANGES(flags) && fails() ? -1 : REAL(name)(folder, path, flags, rights);                               \
    }
OPENS(open)
OPENS(open64)
OPENS_AT(openat)
OPENS_AT(openat64)
