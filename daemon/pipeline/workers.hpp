#pragma once

#include <pthread.h>

#include <atomic>
#include <cstddef>
#include <exception>
#include <functional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "facet/error.hpp"
#include "pipeline/progress.hpp"

namespace facet::pipeline {

/// The threads of a pipeline, with their progress. begin, join: the thread that owns the pipeline.
class Workers {
 public:
  /// The names of the threads; `fail` is called on the thread whose work threw.
  Workers(std::vector<std::string> names, std::function<void(ErrorKind, const std::string&)> fail)
      : progress_(std::move(names)), fail_(std::move(fail)) {}

  void begin(std::size_t worker, std::function<void()> work) {
    ++at_work_;
    progress_.beat(worker);
    threads_.emplace_back([this, worker, work = std::move(work)] {
      ::pthread_setname_np(::pthread_self(), progress_.name(worker).c_str());
      try {
        work();
      } catch (const Error& error) {
        fail_(error.kind(), error.what());
      } catch (const std::exception& error) {
        fail_(ErrorKind::Internal, error.what());
      }
      progress_.end(worker);
      --at_work_;
    });
  }

  /// Waits for all of them. Idempotent.
  void join() {
    for (std::thread& thread : threads_) {
      thread.join();
    }
    threads_.clear();
  }

  bool finished() const { return at_work_ == 0; }  ///< any thread
  /// See Progress::beat.
  void beat(std::size_t worker) { progress_.beat(worker); }
  const Progress& progress() const { return progress_; }

 private:
  Progress progress_;
  std::function<void(ErrorKind, const std::string&)> fail_;
  std::atomic<int> at_work_ = 0;
  std::vector<std::thread> threads_;
};

}  // namespace facet::pipeline
