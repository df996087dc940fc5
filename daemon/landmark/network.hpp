#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "landmark/tflite_model.hpp"

namespace facet::landmark {

/// The part of a graph between one tensor, which becomes its input, and some others, in their order. Throws
/// Error(UnreadableInput) that starts with `name` where an index is no tensor of the model.
TfliteModel part_of(const TfliteModel& model, int input, const std::vector<int>& outputs,
                    const std::string& name);

/// A convolutional net of a TensorFlow Lite graph with one image input, run on the calling thread. One thread
/// at a time; different nets run side by side.
class Network {
 public:
  /// Makes the net ready; a graph that can't be run is an error here. Throws Error(UnreadableInput) that
  /// starts with `name`. The model is not needed afterwards. channels: of the image, 3 for RGB.
  Network(const TfliteModel& model, const std::string& name, int channels = 3);
  ~Network();
  Network(Network&&) noexcept;
  Network& operator=(Network&&) noexcept;

  int input_rows() const;
  int input_columns() const;

  /// The image to work on, [channels][rows][columns]: planar, red first. Write it, then call forward().
  std::span<float> input();

  /// Computes all outputs. Allocates and throws nothing: the shapes were proven by the constructor.
  void forward();

  /// An output in the graph's order, flat in TensorFlow's layout (channels last); valid until the next
  /// forward().
  std::span<const float> output(std::size_t index) const;
  std::size_t output_count() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace facet::landmark
