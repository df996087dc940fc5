#pragma once

// Clang's thread-safety attributes: what a mutex guards and what a function needs of it stand at the
// declaration, and -Wthread-safety (an error where clang builds) holds the code to them. GCC has no such
// attributes. facet/mutex.hpp has the types that they are about.
#if defined(__clang__)
#define FACET_THREAD_ATTRIBUTE(...) __attribute__((__VA_ARGS__))
#else
#define FACET_THREAD_ATTRIBUTE(...)
#endif

/// A class whose objects are held (a mutex), and one that holds such an object while it lives.
#define FACET_CAPABILITY(name) FACET_THREAD_ATTRIBUTE(capability(name))
#define FACET_SCOPED_CAPABILITY FACET_THREAD_ATTRIBUTE(scoped_lockable)
/// A member that only who holds the mutex reads and writes.
#define FACET_GUARDED_BY(mutex) FACET_THREAD_ATTRIBUTE(guarded_by(mutex))
/// A function that is called with the mutex held, and one that is called without it, since it takes it.
#define FACET_REQUIRES(...) FACET_THREAD_ATTRIBUTE(requires_capability(__VA_ARGS__))
#define FACET_EXCLUDES(...) FACET_THREAD_ATTRIBUTE(locks_excluded(__VA_ARGS__))
/// A function that returns with the mutex held, and one that gives it back.
#define FACET_ACQUIRE(...) FACET_THREAD_ATTRIBUTE(acquire_capability(__VA_ARGS__))
#define FACET_RELEASE(...) FACET_THREAD_ATTRIBUTE(release_capability(__VA_ARGS__))
