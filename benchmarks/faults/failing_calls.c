/* A library for LD_PRELOAD that lets one system call on chosen files fail.

   Chosen are the files below the folder that the shared state names; descriptors are followed from open to close.
   Streams of the C library get their data by way of read and write of this file, because the library's own
   system calls cannot be replaced. The state lies in a file (environment FAILING_CALLS_STATE) that every process
   of a command maps, so that calls of all of them are counted together. `failing.py` writes and reads it.

   cc -O2 -fPIC -shared -o failing_calls.so failing_calls.c -ldl */

#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

/* The order is that of KINDS in failing.py. */
enum { OPEN, READ, WRITE, RENAME, UNLINK, FSYNC, FTRUNCATE, MMAP, MKDIR, CLOSE, MALLOC, KINDS };
/* SHORT: half of the bytes are moved. EACH: every second call fails, so that each is made once more; HALVES: every call is short. */
enum { ONCE, FROM_THEN_ON, SHORT, EACH, HALVES };

struct state {
    int64_t armed, kind, nth, error, how, hits;
    int64_t count[16];
    char call[64], path[512], folder[512];
};

static struct state nothing, *state = &nothing;
static char followed[1 << 16]; /* by descriptor: 1 for one of a chosen file */
static FILE *streams[4096];    /* by descriptor: the stream that `fopen` made for it */

#define REAL(result, name, ...)                                           \
    static result (*real)(__VA_ARGS__);                                   \
    if (!real) real = (result(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)

__attribute__((constructor)) static void start(void) {
    const char *name = getenv("FAILING_CALLS_STATE");
    REAL(int, open, const char *, int, ...);
    int fd = name ? real(name, O_RDWR | O_CLOEXEC) : -1;
    if (fd < 0) return;
    void *found = mmap(NULL, sizeof nothing, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (found != MAP_FAILED) state = found;
    close(fd);
}

/* Take another state; for a process that forks one for each case. */
void failing_calls_start(void) { start(); }

static int chosen(int folder, const char *path) {
    char here[4096];
    size_t length;
    if (!state->armed || !path) return 0;
    length = strlen(state->folder);
    if (path[0] == '/') return !strncmp(path, state->folder, length);
    if (folder != AT_FDCWD) return folder >= 0 && folder < (int)sizeof followed && followed[folder];
    return getcwd(here, sizeof here) && !strncmp(here, state->folder, length);
}

static int is_followed(int fd) { return state->armed && fd >= 0 && fd < (int)sizeof followed && followed[fd]; }

static int follow(int fd) {
    if (fd >= 0 && fd < (int)sizeof followed) followed[fd] = 1;
    return fd;
}

/* Count a call; 1 if it is the one that fails, with errno set. */
static int fails(int kind, const char *call, const char *path, int fd) {
    char link[64];
    ssize_t length;
    int64_t n = __atomic_add_fetch(&state->count[kind], 1, __ATOMIC_SEQ_CST);
    if (kind != state->kind || n < state->nth) return 0;
    if (n > state->nth && (state->how == ONCE || state->how == SHORT)) return 0;
    if (state->how == EACH && (n - state->nth) % 2) return 0;
    if (__atomic_add_fetch(&state->hits, 1, __ATOMIC_SEQ_CST) == 1) {
        strncpy(state->call, call, sizeof state->call - 1);
        if (path) strncpy(state->path, path, sizeof state->path - 1);
        else if (fd >= 0) {
            snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
            length = readlink(link, state->path, sizeof state->path - 1);
            state->path[length > 0 ? length : 0] = 0;
        }
    }
    errno = (int)state->error;
    return 1;
}

/* ---- files by name */

#define OPENS(name)                                                       \
    int name(const char *path, int flags, ...) {                          \
        mode_t mode = 0;                                                  \
        va_list rest;                                                     \
        REAL(int, name, const char *, int, ...);                          \
        va_start(rest, flags);                                            \
        if (flags & (O_CREAT | __O_TMPFILE)) mode = va_arg(rest, mode_t); \
        va_end(rest);                                                     \
        if (!chosen(AT_FDCWD, path)) return real(path, flags, mode);      \
        return fails(OPEN, #name, path, -1) ? -1 : follow(real(path, flags, mode)); \
    }
OPENS(open)
OPENS(open64)

#define OPENS_AT(name)                                                    \
    int name(int folder, const char *path, int flags, ...) {              \
        mode_t mode = 0;                                                  \
        va_list rest;                                                     \
        REAL(int, name, int, const char *, int, ...);                     \
        va_start(rest, flags);                                            \
        if (flags & (O_CREAT | __O_TMPFILE)) mode = va_arg(rest, mode_t); \
        va_end(rest);                                                     \
        if (!chosen(folder, path)) return real(folder, path, flags, mode); \
        return fails(OPEN, #name, path, -1) ? -1 : follow(real(folder, path, flags, mode)); \
    }
OPENS_AT(openat)
OPENS_AT(openat64)

int __open_2(const char *path, int flags) { return open(path, flags); }
int __open64_2(const char *path, int flags) { return open64(path, flags); }
int __openat_2(int folder, const char *path, int flags) { return openat(folder, path, flags); }
int __openat64_2(int folder, const char *path, int flags) { return openat64(folder, path, flags); }
int creat(const char *path, mode_t mode) { return open(path, O_CREAT | O_WRONLY | O_TRUNC, mode); }
int creat64(const char *path, mode_t mode) { return open(path, O_CREAT | O_WRONLY | O_TRUNC, mode); }

DIR *opendir(const char *path) {
    REAL(DIR *, opendir, const char *);
    return chosen(AT_FDCWD, path) && fails(OPEN, "opendir", path, -1) ? NULL : real(path);
}

/* A call on names: `test` says whether one of them is chosen. */
#define NAMED(kind, name, parameters, test, path, ...)                    \
    int name parameters {                                                 \
        static int(*real) parameters;                                     \
        if (!real) real = (int(*) parameters)dlsym(RTLD_NEXT, #name);     \
        return (test) && fails(kind, #name, path, -1) ? -1 : real(__VA_ARGS__); \
    }
#define PAIR const char *old, const char *new
#define PAIR_AT int from, const char *old, int to, const char *new
NAMED(RENAME, rename, (PAIR), chosen(AT_FDCWD, old) || chosen(AT_FDCWD, new), new, old, new)
NAMED(RENAME, link, (PAIR), chosen(AT_FDCWD, old) || chosen(AT_FDCWD, new), new, old, new)
NAMED(RENAME, symlink, (PAIR), chosen(AT_FDCWD, new), new, old, new)
NAMED(RENAME, renameat, (PAIR_AT), chosen(from, old) || chosen(to, new), new, from, old, to, new)
NAMED(RENAME, renameat2, (PAIR_AT, unsigned flags), chosen(from, old) || chosen(to, new), new, from, old, to, new, flags)
NAMED(RENAME, linkat, (PAIR_AT, int flags), chosen(from, old) || chosen(to, new), new, from, old, to, new, flags)
NAMED(UNLINK, unlink, (const char *path), chosen(AT_FDCWD, path), path, path)
NAMED(UNLINK, remove, (const char *path), chosen(AT_FDCWD, path), path, path)
NAMED(UNLINK, rmdir, (const char *path), chosen(AT_FDCWD, path), path, path)
NAMED(UNLINK, unlinkat, (int folder, const char *path, int flags), chosen(folder, path), path, folder, path, flags)
NAMED(MKDIR, mkdir, (const char *path, mode_t mode), chosen(AT_FDCWD, path), path, path, mode)
NAMED(MKDIR, mkdirat, (int folder, const char *path, mode_t mode), chosen(folder, path), path, folder, path, mode)
NAMED(FTRUNCATE, truncate, (const char *path, off_t size), chosen(AT_FDCWD, path), path, path, size)
NAMED(FTRUNCATE, truncate64, (const char *path, off64_t size), chosen(AT_FDCWD, path), path, path, size)

/* ---- open files */

#define OF_DESCRIPTOR(result, kind, name, parameters, fd, ...)            \
    result name parameters {                                              \
        static result(*real) parameters;                                  \
        if (!real) real = (result(*) parameters)dlsym(RTLD_NEXT, #name);  \
        return is_followed(fd) && fails(kind, #name, NULL, fd) ? -1 : real(__VA_ARGS__); \
    }
/* The same for a call that moves `size` bytes, or half of them where the state says so. */
#define MOVES(kind, name, parameters, fd, ...)                            \
    ssize_t name parameters {                                             \
        static ssize_t(*real) parameters;                                 \
        if (!real) real = (ssize_t(*) parameters)dlsym(RTLD_NEXT, #name); \
        if (is_followed(fd) && fails(kind, #name, NULL, fd)) {            \
            if (state->how != SHORT && state->how != HALVES) return -1;                           \
            if (size > 1) size /= 2;                                      \
        }                                                                 \
        return real(__VA_ARGS__);                                         \
    }
MOVES(READ, read, (int fd, void *to, size_t size), fd, fd, to, size)
MOVES(READ, pread, (int fd, void *to, size_t size, off_t at), fd, fd, to, size, at)
MOVES(READ, pread64, (int fd, void *to, size_t size, off64_t at), fd, fd, to, size, at)
MOVES(WRITE, write, (int fd, const void *from, size_t size), fd, fd, from, size)
MOVES(WRITE, pwrite, (int fd, const void *from, size_t size, off_t at), fd, fd, from, size, at)
MOVES(WRITE, pwrite64, (int fd, const void *from, size_t size, off64_t at), fd, fd, from, size, at)
MOVES(WRITE, sendfile, (int fd, int source, off_t *at, size_t size), fd, fd, source, at, size)
MOVES(WRITE, sendfile64, (int fd, int source, off64_t *at, size_t size), fd, fd, source, at, size)
MOVES(WRITE, copy_file_range, (int source, off64_t *at, int fd, off64_t *to, size_t size, unsigned flags), fd, source, at, fd, to, size, flags)
MOVES(READ, readv, (int fd, const struct iovec *to, int size), fd, fd, to, size)
MOVES(READ, preadv, (int fd, const struct iovec *to, int size, off_t at), fd, fd, to, size, at)
MOVES(READ, preadv64, (int fd, const struct iovec *to, int size, off64_t at), fd, fd, to, size, at)
MOVES(WRITE, writev, (int fd, const struct iovec *from, int size), fd, fd, from, size)
MOVES(WRITE, pwritev, (int fd, const struct iovec *from, int size, off_t at), fd, fd, from, size, at)
MOVES(WRITE, pwritev64, (int fd, const struct iovec *from, int size, off64_t at), fd, fd, from, size, at)
OF_DESCRIPTOR(int, FSYNC, fsync, (int fd), fd, fd)
OF_DESCRIPTOR(int, FSYNC, fdatasync, (int fd), fd, fd)
OF_DESCRIPTOR(int, FTRUNCATE, ftruncate, (int fd, off_t size), fd, fd, size)
OF_DESCRIPTOR(int, FTRUNCATE, ftruncate64, (int fd, off64_t size), fd, fd, size)
OF_DESCRIPTOR(int, FTRUNCATE, fallocate, (int fd, int mode, off_t at, off_t size), fd, fd, mode, at, size)
OF_DESCRIPTOR(int, FTRUNCATE, fallocate64, (int fd, int mode, off64_t at, off64_t size), fd, fd, mode, at, size)

ssize_t __read_chk(int fd, void *to, size_t size, size_t room) { (void)room; return read(fd, to, size); }
ssize_t __pread_chk(int fd, void *to, size_t size, off_t at, size_t room) { (void)room; return pread(fd, to, size, at); }
ssize_t __pread64_chk(int fd, void *to, size_t size, off64_t at, size_t room) { (void)room; return pread64(fd, to, size, at); }

#define MAPS(name, offset)                                                \
    void *name(void *at, size_t size, int access, int flags, int fd, offset from) { \
        REAL(void *, name, void *, size_t, int, int, int, offset);        \
        return is_followed(fd) && fails(MMAP, #name, NULL, fd) ? MAP_FAILED : real(at, size, access, flags, fd, from); \
    }
MAPS(mmap, off_t)
MAPS(mmap64, off64_t)

/* As Linux does, close the file also where the call fails. */
int close(int fd) {
    REAL(int, close, int);
    int was = is_followed(fd), failed;
    if (fd >= 0 && fd < (int)sizeof followed) followed[fd] = 0;
    failed = was && fails(CLOSE, "close", NULL, fd);
    return real(fd) || failed ? -1 : 0;
}

/* ---- streams of the C library */

static ssize_t stream_read(void *fd, char *to, size_t size) { return read((int)(intptr_t)fd, to, size); }
static ssize_t stream_write(void *fd, const char *from, size_t size) {
    size_t done = 0;
    while (done < size) { /* as the C library does for its own streams */
        ssize_t written = write((int)(intptr_t)fd, from + done, size - done);
        if (written <= 0) break;
        done += (size_t)written;
    }
    return (ssize_t)done;
}
static int stream_seek(void *fd, off64_t *at, int whence) {
    off64_t found = lseek64((int)(intptr_t)fd, *at, whence);
    if (found < 0) return -1;
    *at = found;
    return 0;
}
static int stream_close(void *fd) {
    streams[(intptr_t)fd] = NULL;
    return close((int)(intptr_t)fd);
}

#define STREAMS(name)                                                     \
    FILE *name(const char *path, const char *mode) {                      \
        REAL(FILE *, name, const char *, const char *);                   \
        cookie_io_functions_t how = {stream_read, stream_write, stream_seek, stream_close}; \
        int plus = strchr(mode, '+') != NULL, fd;                         \
        int flags = plus ? O_RDWR : mode[0] == 'r' ? O_RDONLY : O_WRONLY; \
        if (!chosen(AT_FDCWD, path)) return real(path, mode);             \
        if (mode[0] == 'w') flags |= O_CREAT | O_TRUNC;                   \
        if (mode[0] == 'a') flags |= O_CREAT | O_APPEND;                  \
        if (strchr(mode, 'x')) flags |= O_EXCL;                           \
        fd = open(path, flags | O_CLOEXEC, 0666);                         \
        if (fd < 0 || fd >= 4096) return NULL;                            \
        streams[fd] = fopencookie((void *)(intptr_t)fd, mode, how);       \
        if (plus && streams[fd] && !lseek(fd, 0, SEEK_END)) /* a new file: a buffer of both ways is spoilt by seeks */ \
            setvbuf(streams[fd], NULL, _IONBF, 0);                        \
        lseek(fd, 0, flags & O_APPEND ? SEEK_END : SEEK_SET);             \
        return streams[fd];                                               \
    }
STREAMS(fopen)
STREAMS(fopen64)

/* Another stream takes the place of one of ours: whoever calls (f2c's library) goes on with what is returned. */
#define REOPENS(name, opening)                                            \
    FILE *name(const char *path, const char *mode, FILE *stream) {        \
        REAL(FILE *, name, const char *, const char *, FILE *);           \
        for (int n = 0; path && n < 4096; n++)                            \
            if (stream && streams[n] == stream) {                         \
                fclose(stream);                                           \
                return opening(path, mode);                               \
            }                                                             \
        return real(path, mode, stream);                                  \
    }
REOPENS(freopen, fopen)
REOPENS(freopen64, fopen64)

int fileno(FILE *stream) {
    REAL(int, fileno, FILE *);
    int fd = real(stream);
    for (int n = 0; fd < 0 && n < 4096; n++)
        if (streams[n] == stream) return n;
    return fd;
}

/* ---- memory */

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t), *__libc_memalign(size_t, size_t);

static int no_memory(const char *call) { return state->armed && state->kind == MALLOC && fails(MALLOC, call, "", -1); }
void *malloc(size_t size) { return no_memory("malloc") ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return no_memory("calloc") ? NULL : __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { return no_memory("realloc") ? NULL : __libc_realloc(old, size); }
void *memalign(size_t border, size_t size) { return no_memory("memalign") ? NULL : __libc_memalign(border, size); }
void *aligned_alloc(size_t border, size_t size) { return no_memory("aligned_alloc") ? NULL : __libc_memalign(border, size); }
int posix_memalign(void **found, size_t border, size_t size) {
    if (no_memory("posix_memalign")) return ENOMEM;
    *found = __libc_memalign(border, size);
    return *found ? 0 : ENOMEM;
}
