// What the sanitizers do not report: libraries that are not ours and not built for them.
// Compiled into every test and into the programs that tests run; LSAN_OPTIONS and TSAN_OPTIONS add to it.

#ifdef FACET_SANITIZED

extern "C" {

// NOLINTBEGIN(bugprone-reserved-identifier): the names that the sanitizers look for

/// The Vulkan validation layer keeps its records of objects to the end of the process.
const char* __lsan_default_suppressions() {
  return "leak:libVkLayer_khronos_validation.so\n";
}

/// The validation layer's queue threads hand their states over by means that the checker cannot see, and take
/// reader locks in both orders.
const char* __tsan_default_suppressions() {
  return "race:libVkLayer_khronos_validation.so\n"
         "deadlock:libVkLayer_khronos_validation.so\n";
}

// NOLINTEND(bugprone-reserved-identifier)
}

#endif
