#include "support/refused_threads.hpp"

#include <dlfcn.h>
#include <pthread.h>

#include <atomic>
#include <cerrno>

namespace {

std::atomic<int> threads_until_refused{0};

}  // namespace

#ifndef FACET_SANITIZED
extern "C" int pthread_create(pthread_t* thread, const pthread_attr_t* attributes, void* (*work)(void*),
                              void* argument) {
  using Create = int (*)(pthread_t*, const pthread_attr_t*, void* (*)(void*), void*);
  static const auto real = reinterpret_cast<Create>(::dlsym(RTLD_NEXT, "pthread_create"));
  if (threads_until_refused > 0 && --threads_until_refused == 0) {
    return EAGAIN;
  }
  return real(thread, attributes, work, argument);
}
#endif

namespace facet::test {

void refuse_thread(int n) {
  threads_until_refused = n;
}

}  // namespace facet::test
