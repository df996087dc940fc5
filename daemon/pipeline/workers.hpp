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

  /// One worker's number and what it does.
  struct Work {
    std::size_t worker;
    std::function<void()> work;
  };

  /// Begins all of them or none: where a thread can't be made, those made before end without having worked.
  /// Throws Error(Internal) then.
  void begin(const std::vector<Work>& works) {
    gate_ = Gate::Shut;
    try {
      threads_.reserve(works.size());
      for (const Work& one : works) {
        threads_.emplace_back([this, one] { run(one); });
      }
    } catch (const std::exception& error) {
      open(Gate::GoHome);
      threads_.clear();
      throw Error(ErrorKind::Internal, std::string("cannot make the pipeline's threads: ") + error.what());
    }
    for (const Work& one : works) {
      progress_.beat(one.worker);
    }
    at_work_ = static_cast<int>(works.size());
    open(Gate::Work);
  }

  /// Waits for all of them. Idempotent.
  void join() { threads_.clear(); }

  bool finished() const { return at_work_ == 0; }  ///< any thread
  /// See Progress::beat.
  void beat(std::size_t worker) { progress_.beat(worker); }
  const Progress& progress() const { return progress_; }

 private:
  /// What those who were made wait for: that all are.
  enum class Gate { Shut, Work, GoHome };

  void open(Gate gate) {
    gate_ = gate;
    gate_.notify_all();
  }

  void run(const Work& one) {
    gate_.wait(Gate::Shut);
    if (gate_ == Gate::GoHome) {
      return;
    }
    ::pthread_setname_np(::pthread_self(), progress_.name(one.worker).c_str());
    try {
      one.work();
    } catch (const Error& error) {
      fail_(error.kind(), error.what());
    } catch (const std::exception& error) {
      fail_(ErrorKind::Internal, error.what());
    }
    progress_.end(one.worker);
    --at_work_;
  }

  Progress progress_;
  std::function<void(ErrorKind, const std::string&)> fail_;
  std::atomic<int> at_work_ = 0;
  std::atomic<Gate> gate_ = Gate::Shut;
  std::vector<std::jthread> threads_;
};

}  // namespace facet::pipeline
