#pragma once

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "pipeline/frames.hpp"
#include "pipeline/pipeline.hpp"

namespace facet::pipeline {

/// FramesPipeline, and `Meshes`, which makes meshes of its sets, as one pipeline. Who derives from it makes
/// both in its constructor.
template <typename Meshes>
class SetsPipeline : public Pipeline {
 public:
  ~SetsPipeline() override {
    if (frames_ != nullptr) {  // both are there
      SetsPipeline::stop();
    }
  }

  void start() override {
    meshes_->start();
    try {
      frames_->start();
    } catch (...) {
      SetsPipeline::stop();
      throw;
    }
  }
  void request_stop() override {
    frames_->request_stop();
    meshes_->request_stop();
  }
  void stop() override {
    SetsPipeline::request_stop();
    frames_->stop();
    meshes_->stop();
  }
  bool finished() const override { return frames_->finished() && meshes_->finished(); }
  std::optional<Progress::Silence> longest_silence() const override {
    const auto frames = frames_->longest_silence();
    const auto meshes = meshes_->longest_silence();
    return !frames || (meshes && meshes->length > frames->length) ? meshes : frames;
  }
  void reset_identity() override { meshes_->reset_identity(); }
  std::vector<Messages::Message> take_messages() override {
    std::vector<Messages::Message> messages = frames_->take_messages();
    const std::vector<Messages::Message> more = meshes_->take_messages();
    messages.insert(messages.end(), more.begin(), more.end());
    return messages;
  }

 protected:
  std::unique_ptr<Meshes> meshes_;
  std::unique_ptr<FramesPipeline> frames_;  ///< delivers to meshes_
};

}  // namespace facet::pipeline
