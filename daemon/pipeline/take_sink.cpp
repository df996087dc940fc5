#include "pipeline/take_sink.hpp"

#include <fmt/format.h>

#include <utility>

#include "facet/error.hpp"
#include "facet/mutex.hpp"

namespace facet::pipeline {

std::shared_ptr<take::TakeRecorder> TakeSink::current() const {
  const Lock lock(mutex_);
  return recorder_;
}

void TakeSink::deliver(std::shared_ptr<const mesh::MeshFrame> frame) {
  const auto recorder = current();
  if (recorder == nullptr) {
    return;
  }
  if (frame->subject != nullptr && frame->state == mesh::TrackingState::Acquiring) {
    auto without_mesh = std::make_shared<mesh::MeshFrame>(*frame);
    without_mesh->subject = nullptr;
    without_mesh->camera_from_head = Eigen::Isometry3f::Identity();
    without_mesh->reprojection_px = 0;
    without_mesh->expression.clear();
    without_mesh->expression_confidence.clear();
    without_mesh->avatar_values.clear();
    without_mesh->model_weights.clear();
    without_mesh->control_vertices_mm.resize(3, 0);
    frame = std::move(without_mesh);
  }
  recorder->record(std::move(frame));
}

void TakeSink::begin(const take::TakeRecorderConfig& config) {
  if (const auto running = current()) {
    throw Error(ErrorKind::Usage,
                fmt::format("'{}' is being recorded: stop it first", running->status().file.string()));
  }
  {
    const Lock lock(mutex_);
    beginning_ = true;
    end_wanted_.reset();
  }
  std::shared_ptr<take::TakeRecorder> recorder;
  try {
    recorder = std::make_shared<take::TakeRecorder>(config);
    recorder->start();
  } catch (...) {
    const Lock lock(mutex_);
    beginning_ = false;
    throw;
  }
  const Lock lock(mutex_);
  if (end_wanted_) {
    recorder->request_stop(*std::exchange(end_wanted_, std::nullopt));
  }
  recorder_ = std::move(recorder);
  beginning_ = false;
}

void TakeSink::request_end(std::string reason) {
  const Lock lock(mutex_);
  if (recorder_ != nullptr) {
    recorder_->request_stop(std::move(reason));
  } else if (beginning_ && !end_wanted_) {
    end_wanted_ = std::move(reason);
  }
}

bool TakeSink::ended() const {
  const Lock lock(mutex_);
  return !beginning_ && (recorder_ == nullptr || recorder_->ended());
}

std::optional<take::RecorderStatus> TakeSink::end(std::string reason) {
  const auto recorder = current();
  if (recorder == nullptr) {
    return std::nullopt;
  }
  recorder->request_stop(std::move(reason));
  take::RecorderStatus status = recorder->stop();
  const Lock lock(mutex_);
  recorder_ = nullptr;
  return status;
}

std::optional<take::RecorderStatus> TakeSink::status() const {
  const auto recorder = current();
  return recorder != nullptr ? std::optional(recorder->status()) : std::nullopt;
}

}  // namespace facet::pipeline
