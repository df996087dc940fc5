#include "service/stage_opener.hpp"

#include <pthread.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <exception>
#include <utility>

namespace facet::service {

struct StageOpener::Result {
  stream::FileDescriptor wake{::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)};
  std::atomic<bool> done{false};
  std::exception_ptr error;  ///< written before done
  Opened opened;             ///< written before done
};

StageOpener::StageOpener(const Config& config) : result_(std::make_shared<Result>()) {
  if (!result_->wake) {
    throw Error(ErrorKind::Internal, "cannot make an eventfd: too many open files");
  }
  // Ends by itself; joined by the destructor.
  thread_ = std::jthread([result = result_, config] {
    ::pthread_setname_np(::pthread_self(), "facet-open");
    try {
      if (config.mode == Mode::Frames) {
        result->opened = pipeline::open_rig(config.rig);
      } else if (config.mode == Mode::Booth) {
        result->opened = pipeline::open_booth(config.rig, booth_config(config));
      } else if (has_live_views(config)) {
        result->opened = pipeline::open_live_views(config.rig, config.rig_file, config.pipeline);
      } else {
        result->opened = pipeline::open_stages(config.pipeline);
      }
    } catch (...) {
      result->error = std::current_exception();
    }
    result->done = true;
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t ignored = ::write(result->wake.get(), &one, sizeof(one));
  });
}

int StageOpener::fd() const {
  return result_->wake.get();
}

bool StageOpener::done() const {
  return result_->done;
}

Opened StageOpener::take() {
  if (result_->error != nullptr) {
    std::rethrow_exception(result_->error);
  }
  return std::move(result_->opened);
}

}  // namespace facet::service
