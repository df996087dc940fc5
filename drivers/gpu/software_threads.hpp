#pragma once

namespace facet::gpu {

/// Cores that this process may use.
int allowed_core_count();

/// Has lavapipe start one worker thread for each core that this process may use (LP_NUM_THREADS), unless the
/// environment says otherwise. Before the driver is loaded; changes the environment, so before threads that
/// read it.
void choose_software_thread_count();

/// Pins lavapipe's worker threads, "llvmpipe-0" and so on, one to each core that this process may use. They
/// are there once a device is open. What cannot be pinned is left as it is: it only costs speed.
void pin_software_threads();

}  // namespace facet::gpu
