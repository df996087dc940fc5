/* Preloaded into facetd: makes the n-th call of one kind fail, once, as want of memory, threads, descriptors or
   disk would. Which and when stands in the file NTH_CALL, which is mapped; check-nth-call writes it. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/timerfd.h>
#include <sys/uio.h>
#include <unistd.h>

enum Kind { kThread = 1, kDescriptor, kWrite, kSend, kSync, kTruncate, kRename, kMap, kAllocation };

struct Control { /* check-nth-call has the same layout */
  _Atomic int32_t armed;
  _Atomic int32_t kind;
  _Atomic int64_t n; /* from 1 */
  _Atomic int64_t count;
  _Atomic int32_t hits;
  char what[108]; /* the call and the thread that was hit */
};

static struct Control* control;
/* Before main no program can do anything about want of memory. The daemon's first call in main is pthread_sigmask. */
static _Atomic int in_main;

/* The C library's own, as nothing of ours may allocate on the way to them. */
extern void* __libc_malloc(size_t);
extern void* __libc_calloc(size_t, size_t);
extern void* __libc_realloc(void*, size_t);
extern void* __libc_memalign(size_t, size_t);

static void* real(const char* name) {
  return dlsym(RTLD_NEXT, name);
}

static int fails(int32_t kind, const char* call) {
  if (!control || !control->armed || control->kind != kind || !in_main) return 0;
  if (atomic_fetch_add(&control->count, 1) + 1 != control->n) return 0;
  char thread[16] = "";
  pthread_getname_np(pthread_self(), thread, sizeof thread);
  strncpy(control->what, call, 80);
  strncat(control->what, " in ", 5);
  strncat(control->what, thread, 16);
  control->hits += 1;
  return 1;
}

/* What does not go to a file may fail in ways of its own, which are no want of disk. */
static int of_file(int fd) {
  struct stat status;
  const int saved = errno;
  const int file = control && control->armed && fstat(fd, &status) == 0 && S_ISREG(status.st_mode);
  errno = saved;
  return file;
}

static int is_folder(int fd) {
  struct stat status;
  return fstat(fd, &status) == 0 && S_ISDIR(status.st_mode);
}

#define FAIL(code, result)  \
  do {                      \
    errno = (code);         \
    return result;          \
  } while (0)

/* name: as this library has it; the arguments are those of the C library's. */
#define WRAP(result, name, arguments, values, when, error, failed)                   \
  result name arguments {                                                            \
    static __typeof__(&name) next;                                                   \
    if (!next) next = (__typeof__(&name))real(#name);                                \
    if (when) FAIL(error, failed);                                                   \
    return next values;                                                              \
  }

int pthread_sigmask(int how, const sigset_t* set, sigset_t* old) {
  static __typeof__(&pthread_sigmask) next;
  if (!next) next = (__typeof__(&pthread_sigmask))real("pthread_sigmask");
  in_main = 1;
  return next(how, set, old);
}

int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*work)(void*), void* argument) {
  static __typeof__(&pthread_create) next;
  if (!next) next = (__typeof__(&pthread_create))real("pthread_create");
  if (fails(kThread, "pthread_create")) return EAGAIN;
  return next(thread, attributes, work, argument);
}

#define WRAP_OPEN(name)                                                              \
  int name(const char* file, int flags, ...) {                                       \
    static __typeof__(&name) next;                                                   \
    va_list more;                                                                    \
    va_start(more, flags);                                                           \
    const mode_t mode = va_arg(more, mode_t);                                        \
    va_end(more);                                                                    \
    if (!next) next = (__typeof__(&name))real(#name);                                \
    if (fails(kDescriptor, #name)) FAIL(EMFILE, -1);                                 \
    return next(file, flags, mode);                                                  \
  }
#define WRAP_OPENAT(name)                                                            \
  int name(int folder, const char* file, int flags, ...) {                           \
    static __typeof__(&name) next;                                                   \
    va_list more;                                                                    \
    va_start(more, flags);                                                           \
    const mode_t mode = va_arg(more, mode_t);                                        \
    va_end(more);                                                                    \
    if (!next) next = (__typeof__(&name))real(#name);                                \
    if (fails(kDescriptor, #name)) FAIL(EMFILE, -1);                                 \
    return next(folder, file, flags, mode);                                          \
  }
#define WRAP_FCNTL(name)                                                             \
  int name(int fd, int command, ...) {                                               \
    static __typeof__(&name) next;                                                   \
    va_list more;                                                                    \
    va_start(more, command);                                                         \
    void* const argument = va_arg(more, void*);                                      \
    va_end(more);                                                                    \
    if (!next) next = (__typeof__(&name))real(#name);                                \
    if ((command == F_DUPFD || command == F_DUPFD_CLOEXEC) && fails(kDescriptor, #name)) FAIL(EMFILE, -1); \
    return next(fd, command, argument);                                              \
  }
WRAP_OPEN(open)
WRAP_OPEN(open64)
WRAP_OPENAT(openat)
WRAP_OPENAT(openat64)
WRAP_FCNTL(fcntl)
WRAP_FCNTL(fcntl64)
WRAP(FILE*, fopen, (const char* f, const char* m), (f, m), fails(kDescriptor, "fopen"), EMFILE, NULL)
WRAP(FILE*, fopen64, (const char* f, const char* m), (f, m), fails(kDescriptor, "fopen64"), EMFILE, NULL)
WRAP(int, socket, (int d, int t, int p), (d, t, p), fails(kDescriptor, "socket"), EMFILE, -1)
WRAP(int, socketpair, (int d, int t, int p, int v[2]), (d, t, p, v), fails(kDescriptor, "socketpair"), EMFILE, -1)
WRAP(int, accept4, (int s, struct sockaddr* a, socklen_t* l, int f), (s, a, l, f), fails(kDescriptor, "accept4"), EMFILE, -1)
WRAP(int, eventfd, (unsigned i, int f), (i, f), fails(kDescriptor, "eventfd"), EMFILE, -1)
WRAP(int, epoll_create1, (int f), (f), fails(kDescriptor, "epoll_create1"), EMFILE, -1)
WRAP(int, timerfd_create, (clockid_t c, int f), (c, f), fails(kDescriptor, "timerfd_create"), EMFILE, -1)
WRAP(int, memfd_create, (const char* n, unsigned f), (n, f), fails(kDescriptor, "memfd_create"), EMFILE, -1)
WRAP(int, dup, (int fd), (fd), fails(kDescriptor, "dup"), EMFILE, -1)
WRAP(int, pipe2, (int p[2], int f), (p, f), fails(kDescriptor, "pipe2"), EMFILE, -1)

WRAP(ssize_t, write, (int fd, const void* b, size_t n), (fd, b, n), of_file(fd) && fails(kWrite, "write"), ENOSPC, -1)
WRAP(ssize_t, pwrite, (int fd, const void* b, size_t n, off_t o), (fd, b, n, o), of_file(fd) && fails(kWrite, "pwrite"), ENOSPC, -1)
WRAP(ssize_t, pwrite64, (int fd, const void* b, size_t n, off64_t o), (fd, b, n, o), of_file(fd) && fails(kWrite, "pwrite64"), ENOSPC, -1)
WRAP(ssize_t, writev, (int fd, const struct iovec* v, int n), (fd, v, n), of_file(fd) && fails(kWrite, "writev"), ENOSPC, -1)
WRAP(ssize_t, sendmsg, (int s, const struct msghdr* m, int f), (s, m, f), fails(kSend, "sendmsg"), ENOBUFS, -1)
WRAP(ssize_t, send, (int s, const void* b, size_t n, int f), (s, b, n, f), fails(kSend, "send"), ENOBUFS, -1)
WRAP(int, fsync, (int fd), (fd), fails(kSync, "fsync"), EIO, -1)
WRAP(int, fdatasync, (int fd), (fd), fails(kSync, is_folder(fd) ? "SQLite's sync of a folder" : "fdatasync"), EIO, -1)
WRAP(int, sync_file_range, (int fd, off64_t o, off64_t n, unsigned f), (fd, o, n, f), fails(kSync, "sync_file_range"), EIO, -1)
WRAP(int, ftruncate, (int fd, off_t n), (fd, n), fails(kTruncate, "ftruncate"), ENOSPC, -1)
WRAP(int, ftruncate64, (int fd, off64_t n), (fd, n), fails(kTruncate, "ftruncate64"), ENOSPC, -1)
WRAP(int, fallocate, (int fd, int m, off_t o, off_t n), (fd, m, o, n), fails(kTruncate, "fallocate"), ENOSPC, -1)
WRAP(int, fallocate64, (int fd, int m, off64_t o, off64_t n), (fd, m, o, n), fails(kTruncate, "fallocate64"), ENOSPC, -1)
WRAP(int, rename, (const char* a, const char* b), (a, b), fails(kRename, "rename"), EIO, -1)
WRAP(int, renameat2, (int x, const char* a, int y, const char* b, unsigned f), (x, a, y, b, f), fails(kRename, "renameat2"), EIO, -1)
WRAP(int, linkat, (int x, const char* a, int y, const char* b, int f), (x, a, y, b, f), fails(kRename, "linkat"), EIO, -1)
WRAP(int, unlink, (const char* f), (f), fails(kRename, "unlink"), EIO, -1)
WRAP(int, mkdir, (const char* f, mode_t m), (f, m), fails(kRename, "mkdir"), EIO, -1)
WRAP(void*, mmap, (void* p, size_t n, int r, int f, int fd, off_t o), (p, n, r, f, fd, o), fails(kMap, "mmap"), ENOMEM, MAP_FAILED)
WRAP(void*, mmap64, (void* p, size_t n, int r, int f, int fd, off64_t o), (p, n, r, f, fd, o), fails(kMap, "mmap64"), ENOMEM, MAP_FAILED)

void* malloc(size_t size) {
  if (fails(kAllocation, "malloc")) FAIL(ENOMEM, NULL);
  return __libc_malloc(size);
}
void* calloc(size_t count, size_t size) {
  if (fails(kAllocation, "calloc")) FAIL(ENOMEM, NULL);
  return __libc_calloc(count, size);
}
void* realloc(void* memory, size_t size) {
  if (fails(kAllocation, "realloc")) FAIL(ENOMEM, NULL);
  return __libc_realloc(memory, size);
}
void* memalign(size_t alignment, size_t size) {
  if (fails(kAllocation, "memalign")) FAIL(ENOMEM, NULL);
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(size_t alignment, size_t size) {
  if (fails(kAllocation, "aligned_alloc")) FAIL(ENOMEM, NULL);
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** out, size_t alignment, size_t size) {
  if (fails(kAllocation, "posix_memalign")) return ENOMEM;
  void* const memory = __libc_memalign(alignment, size);
  if (!memory) return ENOMEM;
  *out = memory;
  return 0;
}

__attribute__((constructor)) static void begin(void) {
  const char* const file = getenv("NTH_CALL");
  const int fd = file ? open(file, O_RDWR | O_CLOEXEC) : -1;
  void* const memory = fd >= 0 ? mmap(NULL, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0) : MAP_FAILED;
  if (fd >= 0) close(fd);
  if (memory != MAP_FAILED) control = memory;
}
