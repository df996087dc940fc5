// What the sanitizers do not report: libraries that are not ours and not built for them.
// Compiled into every test and into the programs that tests run; LSAN_OPTIONS and TSAN_OPTIONS add to it.

#ifdef FACET_SANITIZED

extern "C" {

// NOLINTBEGIN(bugprone-reserved-identifier): the names that the sanitizers look for

/// With it on, LeakSanitizer of Clang 14 crashes over the thread-local memory of libraries that are opened
/// late.
const char* __asan_default_options() {
  return "intercept_tls_get_addr=0";
}

/// The Vulkan validation layer keeps its records of objects to the end of the process. A device that hangs is
/// left behind with all that is on it (Device::abandon); what else of a device is not destroyed the layer
/// tells. Assimp, which tests read an FBX with, loses some of what it read.
const char* __lsan_default_suppressions() {
  return "leak:libVkLayer_khronos_validation.so\n"
         "leak:libvulkan_lvp.so\n"
         "leak:libassimp.so\n";
}

/// FFmpeg's frame threads, the software device's workers, those of Embree and the validation layer's queue
/// threads hand their states over by atomics of their own, which the checker cannot see; the layer takes
/// reader locks in both orders. A stopping facetd leaves without a thread that a driver holds.
const char* __tsan_default_suppressions() {
  return "race:libavcodec.so\n"
         "race:libavutil.so\n"
         "race:libembree3.so\n"
         "race:libtbb.so\n"
         "race:libvulkan_lvp.so\n"
         "race:libVkLayer_khronos_validation.so\n"
         "deadlock:libVkLayer_khronos_validation.so\n"
         "deadlock:libgdal.so\n"
         "thread:Workers::begin\n"
         "thread:ShadingPipeline::start\n"
         "thread:FramesPipeline::start\n"
         "thread:PipelineOpener\n";
}

// NOLINTEND(bugprone-reserved-identifier)
}

#endif
