#include "service/pipeline_opener.hpp"

#include <pthread.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <exception>
#include <utility>

namespace facet::service {

struct PipelineOpener::Result {
  stream::FileDescriptor wake{::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)};
  std::atomic<bool> done{false};
  std::exception_ptr error;  ///< written before done
  OpenedPipeline opened;     ///< written before done
};

PipelineOpener::PipelineOpener(const Config& config) : result_(std::make_shared<Result>()) {
  if (!result_->wake) {
    throw Error(ErrorKind::Internal, "cannot make an eventfd: too many open files");
  }
  // Ends by itself; joined by the destructor.
  thread_ = std::jthread([result = result_, config] {
    ::pthread_setname_np(::pthread_self(), "facet-open");
    try {
      result->opened = mode_row(config.mode).open(config);
    } catch (...) {
      result->error = std::current_exception();
    }
    result->done = true;
    const std::uint64_t one = 1;
    [[maybe_unused]] const ssize_t ignored = ::write(result->wake.get(), &one, sizeof(one));
  });
}

int PipelineOpener::fd() const {
  return result_->wake.get();
}

bool PipelineOpener::done() const {
  return result_->done;
}

OpenedPipeline PipelineOpener::take() {
  if (result_->error != nullptr) {
    std::rethrow_exception(result_->error);
  }
  return std::move(result_->opened);
}

}  // namespace facet::service
