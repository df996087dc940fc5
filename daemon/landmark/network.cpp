#include "landmark/network.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <functional>
#include <map>
#include <new>
#include <utility>

#include "facet/error.hpp"
#include "landmark/net_kernels.hpp"

namespace facet::landmark {
namespace {

/// Of one tensor: more than any net that finds a face has, far below what a forged shape could claim.
constexpr std::size_t kMostElements = std::size_t{1} << 24U;

/// What one tensor's numbers lie in. Pictures have extents; other tensors are flat, as TensorFlow has them.
struct Place {
  Extents extents;
  bool picture = false;
  float* values = nullptr;
};

/// Memory that later tensors use again once nobody reads the earlier one.
class Arena {
 public:
  float* take(std::size_t floats) {
    Block* best = nullptr;
    for (Block& block : blocks_) {
      if (block.free && block.floats >= floats && (best == nullptr || block.floats < best->floats)) {
        best = &block;
      }
    }
    if (best == nullptr) {
      best = &blocks_.emplace_back(floats);
    }
    best->free = false;
    return best->values.get();
  }
  void give_back(const float* values) {
    for (Block& block : blocks_) {
      block.free = block.free || block.values.get() == values;
    }
  }

 private:
  static constexpr std::align_val_t kAlignment{64};  ///< a line of the cache
  struct Free {
    void operator()(float* values) const { ::operator delete[](values, kAlignment); }
  };
  struct Block {
    explicit Block(std::size_t count)
        : floats(count), values(static_cast<float*>(::operator new[](count * sizeof(float), kAlignment))) {}
    std::size_t floats;
    std::unique_ptr<float[], Free> values;
    bool free = false;
  };
  std::vector<Block> blocks_;
};

/// A net made ready: what forward() does, one after the other.
struct Program {
  std::vector<std::function<void()>> steps;
  Arena arena;
  Extents input_extents;
  std::vector<float> input;  ///< [channels][rows][columns]
  /// An output, flat; a picture whose pixels have gaps is copied to `copies`.
  std::vector<std::span<const float>> outputs;
  std::vector<std::vector<float>> copies;
  std::vector<float> patches;  ///< of gather_row, as long as any convolution needs
};

/// Makes steps of a graph's operators, in their order. An addition and what follows it are done with the
/// convolution before where nobody else reads that one's result.
class NetBuilder {
 public:
  NetBuilder(const TfliteModel& model, std::string name, int channels, Program& net)
      : model_(model), name_(std::move(name)), net_(net), places_(model.tensors.size()) {
    if (model.inputs.size() != 1 || tensor(model.inputs[0]).shape.size() != 4 ||
        tensor(model.inputs[0]).shape[0] != 1 || tensor(model.inputs[0]).shape[3] != channels) {
      fail(channels == 3 ? "the net must have one RGB image as its input"
                         : fmt::format("the net must have one image of {} channels as its input", channels));
    }
    count_uses();
    for (const TfliteOperator& op : model.operators) {
      if (op.kind == OperatorKind::Dequantize) {
        dequantized_[result(op)] = operand(op, 0);
      }
    }
    add_input();
    done_.assign(model.operators.size(), false);
    for (std::size_t i = 0; i < model.operators.size(); ++i) {
      if (!done_[i]) {
        add(i);
      }
    }
    net_.copies.reserve(model.outputs.size());
    for (const int output : model.outputs) {
      add_output(output);
    }
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("{}: {}", name_, what));
  }

  const TfliteTensor& tensor(int index) const { return model_.tensors.at(static_cast<std::size_t>(index)); }

  int operand(const TfliteOperator& op, std::size_t position) const {
    if (position >= op.inputs.size() || op.inputs[position] < 0) {
      fail(fmt::format("an operator lacks its operand {}", position));
    }
    return op.inputs[position];
  }
  int result(const TfliteOperator& op) const {
    if (op.outputs.size() != 1) {
      fail(fmt::format("an operator has {} results", op.outputs.size()));
    }
    return op.outputs[0];
  }

  /// A constant operand as floats; weights are stored as float16 behind a Dequantize.
  std::vector<float> floats(int index) const {
    const auto source = dequantized_.find(index);
    return model_.constant_floats(source == dequantized_.end() ? index : source->second);
  }

  /// A tensor that is there.
  const Place& place(int index) const {
    const Place& found = places_.at(static_cast<std::size_t>(index));
    if (found.values == nullptr) {
      fail(fmt::format("tensor {} ({}) is used before it is computed", index, tensor(index).name));
    }
    return found;
  }
  const Place& picture(int index) const {
    const Place& found = place(index);
    if (!found.picture) {
      fail(fmt::format("tensor {} ({}) is no picture where one is needed", index, tensor(index).name));
    }
    return found;
  }

  static bool is_picture(const std::vector<int>& shape) { return shape.size() == 4 && shape[0] == 1; }

  void count_uses() {
    uses_.assign(model_.tensors.size(), 0);
    for (const TfliteOperator& op : model_.operators) {
      for (const int input : op.inputs) {
        if (input >= 0) {
          ++uses_.at(static_cast<std::size_t>(input));
        }
      }
    }
    for (const int output : model_.outputs) {
      ++uses_.at(static_cast<std::size_t>(output));
    }
  }

  /// Room for a tensor of these extents, which must be what the graph says.
  float* make_picture(int index, const Extents& extents) {
    const std::vector<int>& shape = tensor(index).shape;
    if (!is_picture(shape) || extents.rows < 1 || extents.columns < 1 ||
        extents != Extents{shape[1], shape[2], shape[3]}) {
      fail(fmt::format("tensor {} ({}) has not the shape of what is computed", index, tensor(index).name));
    }
    return make(index, {extents, true, nullptr});
  }
  float* make_flat(int index, std::size_t elements) {
    if (tensor(index).element_count() != elements) {
      fail(fmt::format("tensor {} ({}) has not as many elements as what is computed", index,
                       tensor(index).name));
    }
    return make(index, {});
  }
  float* make(int index, Place made) {
    const std::size_t pixels = made.picture ? made.extents.pixels() : 1;
    const std::size_t each = made.picture ? made.extents.stride() : tensor(index).element_count();
    if (pixels > kMostElements || each > kMostElements / pixels ||
        places_[static_cast<std::size_t>(index)].values != nullptr) {
      fail(fmt::format("tensor {} ({}) is too large, or computed twice", index, tensor(index).name));
    }
    made.values = net_.arena.take(pixels * each);
    places_[static_cast<std::size_t>(index)] = made;
    return made.values;
  }

  /// After the step that reads it was made: what nobody reads any more gives its memory to what comes.
  void used(int index) {
    if (--uses_[static_cast<std::size_t>(index)] == 0) {
      net_.arena.give_back(places_[static_cast<std::size_t>(index)].values);
    }
  }

  void add_input() {
    const int index = model_.inputs[0];
    const std::vector<int>& shape = tensor(index).shape;
    net_.input_extents = {shape[1], shape[2], shape[3]};
    float* const out = make_picture(index, net_.input_extents);
    net_.input.resize(tensor(index).element_count());
    net_.steps.emplace_back([&net = net_, out] {
      const std::size_t pixels = net.input_extents.pixels();
      const std::size_t stride = net.input_extents.stride();
      const auto channels = static_cast<std::size_t>(net.input_extents.channels);
      for (std::size_t pixel = 0; pixel < pixels; ++pixel) {
        for (std::size_t c = 0; c < channels; ++c) {
          out[pixel * stride + c] = net.input[c * pixels + pixel];
        }
        std::fill(out + pixel * stride + channels, out + (pixel + 1) * stride, 0.0F);
      }
    });
  }

  void add_output(int index) {
    const Place& from = place(index);
    const std::size_t elements = tensor(index).element_count();
    const auto channels = static_cast<std::size_t>(from.extents.channels);
    if (!from.picture || channels == from.extents.stride()) {
      net_.outputs.emplace_back(from.values, elements);
      return;
    }
    float* const out = net_.copies.emplace_back(elements).data();
    net_.outputs.emplace_back(out, elements);
    net_.steps.emplace_back([from, out] { close_gaps(from, out); });
  }

  /// A picture's numbers as TensorFlow has them.
  static void close_gaps(const Place& from, float* out) {
    const auto channels = static_cast<std::size_t>(from.extents.channels);
    for (std::size_t pixel = 0; pixel < from.extents.pixels(); ++pixel) {
      std::copy_n(from.values + pixel * from.extents.stride(), channels, out + pixel * channels);
    }
  }

  void add(std::size_t number) {
    const TfliteOperator& op = model_.operators[number];
    switch (op.kind) {
      case OperatorKind::Dequantize:
        return;
      case OperatorKind::Conv2d:
        return add_convolution(number);
      case OperatorKind::DepthwiseConv2d:
        return add_depthwise(op);
      case OperatorKind::Prelu:
      case OperatorKind::Relu:
      case OperatorKind::Add:
        return add_elementwise(op);
      case OperatorKind::MaxPool2d:
        return add_max_pool(op);
      case OperatorKind::Pad:
        return add_pad(op);
      case OperatorKind::Reshape:
        return add_reshape(op);
      case OperatorKind::Concatenation:
        return add_concatenation(op);
      case OperatorKind::Mul:
      case OperatorKind::StridedSlice:
      case OperatorKind::Custom:
        fail(fmt::format("holds an operator that this net builder does not know (custom name '{}')",
                         op.custom_name));
    }
  }

  /// One value a channel, and zeros up to the stride.
  std::vector<float> of_channels(int index, const Extents& extents, const char* what) const {
    std::vector<float> values = floats(index);
    if (values.size() != static_cast<std::size_t>(extents.channels)) {
      fail(what);
    }
    values.resize(extents.stride());
    return values;
  }
  /// Slopes of a PReLU or a ReLU.
  std::vector<float> slopes_of(const TfliteOperator& op, const Extents& extents) const {
    return op.kind == OperatorKind::Relu
               ? std::vector<float>(extents.stride())
               : of_channels(operand(op, 1), extents, "a PReLU must have one slope for each channel");
  }

  /// What a convolution does with its sums; `slopes` outlives its use by the step that holds it.
  struct Fused {
    int result = -1;  ///< the tensor that then is there
    int added = -1;
    std::vector<float> slopes;
  };

  /// The only operator that reads a tensor, if that is all that does.
  const TfliteOperator* only_reader(int index, std::size_t& number) const {
    if (uses_[static_cast<std::size_t>(index)] != 1) {
      return nullptr;
    }
    const auto& all = model_.operators;
    const auto reader = std::find_if(all.begin(), all.end(), [&](const TfliteOperator& op) {
      return std::find(op.inputs.begin(), op.inputs.end(), index) != op.inputs.end();
    });
    number = static_cast<std::size_t>(reader - all.begin());
    return reader == all.end() ? nullptr : &*reader;
  }

  /// Takes on what follows a convolution: the addition of a picture that is there already, then a PReLU.
  Fused fuse(int convolved, const Extents& extents) {
    Fused fused;
    fused.result = convolved;
    std::size_t number = 0;
    const TfliteOperator* next = only_reader(convolved, number);
    if (next != nullptr && next->kind == OperatorKind::Add && next->inputs.size() == 2) {
      const int other = next->inputs[next->inputs[0] == convolved ? 1 : 0];
      const Place* const there = other >= 0 ? &places_[static_cast<std::size_t>(other)] : nullptr;
      if (there == nullptr || there->values == nullptr || !there->picture || there->extents != extents) {
        return fused;  // not there yet, or to be refused in its turn
      }
      fused.added = other;
      fused.result = result(*next);
      done_[number] = true;
      next = only_reader(fused.result, number);
    }
    if (next != nullptr && (next->kind == OperatorKind::Prelu || next->kind == OperatorKind::Relu) &&
        operand(*next, 0) == fused.result) {
      fused.slopes = slopes_of(*next, extents);
      fused.result = result(*next);
      done_[number] = true;
    }
    return fused;
  }

  /// Conv2d weights are [outputs][rows][columns][inputs].
  void add_convolution(std::size_t number) {
    const TfliteOperator& op = model_.operators[number];
    const std::vector<int>& shape = tensor(operand(op, 1)).shape;
    const Place& in = picture(operand(op, 0));
    if (shape.size() != 4 || shape[3] != in.extents.channels) {
      fail("a convolution's weights do not fit its input");
    }
    Extents extents{0, 0, shape[0]};
    const Window window = window_over(op, shape[1], shape[2], in.extents, extents);
    const std::vector<float> values = floats(op.inputs[1]);
    if (values.size() != tensor(op.inputs[1]).element_count()) {
      fail("a convolution's weights do not fit their shape");
    }
    std::vector<float> bias =
        of_channels(operand(op, 2), extents, "a convolution's bias does not fit its weights");
    const std::size_t depth = values.size() / static_cast<std::size_t>(shape[0]);
    PackedWeights weights(values, shape[0], static_cast<int>(depth));

    Fused fused = fuse(result(op), extents);
    const float* const added =
        fused.added < 0 ? nullptr : places_[static_cast<std::size_t>(fused.added)].values;
    check_shape(result(op), extents);
    float* const out = make_picture(fused.result, extents);
    const bool plain =
        window.rows == 1 && window.columns == 1 && window.row_stride == 1 && window.column_stride == 1;
    if (!plain) {
      const std::size_t patches = depth * static_cast<std::size_t>(extents.columns);
      if (patches > kMostElements) {
        fail("a convolution is too large");
      }
      net_.patches.resize(std::max(net_.patches.size(), patches + kLanes));
    }
    net_.steps.emplace_back([&net = net_, in, window, extents, plain, added, out,
                             weights = std::move(weights), bias = std::move(bias),
                             slopes = std::move(fused.slopes)] {
      Finish finish{bias.data(), added, slopes.empty() ? nullptr : slopes.data()};
      if (plain) {
        multiply(in.values, in.extents.stride(), extents.pixels(), weights, finish, out);
        return;
      }
      const std::size_t row_floats = static_cast<std::size_t>(extents.columns) * extents.stride();
      for (int row = 0; row < extents.rows; ++row) {
        gather_row(in.values, in.extents, window, extents, row, net.patches.data());
        const std::size_t offset = static_cast<std::size_t>(row) * row_floats;
        finish.added = added == nullptr ? nullptr : added + offset;
        multiply(net.patches.data(), weights.depth(), static_cast<std::size_t>(extents.columns), weights,
                 finish, out + offset);
      }
    });
    used(op.inputs[0]);
    if (fused.added >= 0) {
      used(fused.added);
    }
  }

  /// The graph must say of a tensor that is never made what was computed, too.
  void check_shape(int index, const Extents& extents) const {
    const std::vector<int>& shape = tensor(index).shape;
    if (!is_picture(shape) || extents != Extents{shape[1], shape[2], shape[3]}) {
      fail(fmt::format("tensor {} ({}) has not the shape of what is computed", index, tensor(index).name));
    }
  }

  /// Depthwise weights are [1][rows][columns][channels].
  void add_depthwise(const TfliteOperator& op) {
    const std::vector<int>& shape = tensor(operand(op, 1)).shape;
    const Place& in = picture(operand(op, 0));
    if (shape.size() != 4 || shape[3] != in.extents.channels || shape[0] != 1) {
      fail("a convolution's weights do not fit its input");
    }
    Extents extents{0, 0, shape[3]};
    const Window window = window_over(op, shape[1], shape[2], in.extents, extents);
    const std::vector<float> values = floats(op.inputs[1]);
    std::vector<float> bias =
        of_channels(operand(op, 2), extents, "a convolution's bias does not fit its weights");
    const auto channels = static_cast<std::size_t>(shape[3]);
    if (values.size() != tensor(op.inputs[1]).element_count() || values.size() > kMostElements) {
      fail("a convolution's weights do not fit their shape");
    }
    std::vector<float> weights(values.size() / channels * extents.stride());
    for (std::size_t i = 0; i < values.size(); ++i) {
      weights[i / channels * extents.stride() + i % channels] = values[i];
    }
    float* const out = make_picture(result(op), extents);
    net_.steps.emplace_back([in, window, extents, out, weights = std::move(weights), bias = std::move(bias)] {
      convolve_depthwise(in.values, in.extents, window, weights.data(), {bias.data(), nullptr, nullptr},
                         extents, out);
    });
    used(op.inputs[0]);
  }

  void add_elementwise(const TfliteOperator& op) {
    const Place& in = picture(operand(op, 0));
    const bool adds = op.kind == OperatorKind::Add;
    if (adds && picture(operand(op, 1)).extents != in.extents) {
      fail("an addition has operands of two shapes");
    }
    const float* const added = adds ? picture(op.inputs[1]).values : nullptr;
    std::vector<float> slopes = adds ? std::vector<float>() : slopes_of(op, in.extents);
    float* const out = make_picture(result(op), in.extents);
    net_.steps.emplace_back([in, added, out, slopes = std::move(slopes)] {
      apply(in.values, in.extents, {nullptr, added, slopes.empty() ? nullptr : slopes.data()}, out);
    });
    used(op.inputs[0]);
    if (adds) {
      used(op.inputs[1]);
    }
  }

  void add_max_pool(const TfliteOperator& op) {
    const Place& in = picture(operand(op, 0));
    Extents extents{0, 0, in.extents.channels};
    const Window window = window_over(op, op.filter_rows, op.filter_columns, in.extents, extents);
    float* const out = make_picture(result(op), extents);
    net_.steps.emplace_back(
        [in, window, extents, out] { pool_largest(in.values, in.extents, window, extents, out); });
    used(op.inputs[0]);
  }

  void add_pad(const TfliteOperator& op) {
    const std::vector<int> widths = model_.constant_ints(operand(op, 1));
    constexpr int kMostPadding = 1 << 16;
    if (widths.size() != 8 || widths[0] != 0 || widths[1] != 0 ||
        std::any_of(widths.begin(), widths.end(), [](int w) { return w < 0 || w > kMostPadding; })) {
      fail("a padding must give two widths for each of four dimensions, and none of several pictures");
    }
    const Place& in = picture(operand(op, 0));
    const Extents extents{in.extents.rows + widths[2] + widths[3], in.extents.columns + widths[4] + widths[5],
                          in.extents.channels + widths[6] + widths[7]};
    float* const out = make_picture(result(op), extents);
    const std::size_t first =
        (static_cast<std::size_t>(widths[2]) * static_cast<std::size_t>(extents.columns) +
         static_cast<std::size_t>(widths[4])) *
            extents.stride() +
        static_cast<std::size_t>(widths[6]);
    net_.steps.emplace_back([in, extents, first, out] {
      std::fill_n(out, extents.pixels() * extents.stride(), 0.0F);
      const auto columns = static_cast<std::size_t>(in.extents.columns);
      for (std::size_t pixel = 0; pixel < in.extents.pixels(); ++pixel) {
        const std::size_t to = pixel / columns * static_cast<std::size_t>(extents.columns) + pixel % columns;
        std::copy_n(in.values + pixel * in.extents.stride(), static_cast<std::size_t>(in.extents.channels),
                    out + first + to * extents.stride());
      }
    });
    used(op.inputs[0]);
  }

  /// Reshape keeps the order of the elements in TensorFlow's layout.
  void add_reshape(const TfliteOperator& op) {
    const int index = result(op);
    const std::vector<int>& shape = tensor(index).shape;
    if (shape.empty() || (shape.size() == 4 && (shape[1] > 1 || shape[2] > 1))) {
      fail("reshaping into an image is not supported");
    }
    const int source = operand(op, 0);
    const Place& in = place(source);
    const std::size_t elements = tensor(source).element_count();
    float* const out = make_flat(index, elements);
    net_.steps.emplace_back([in, elements, out] {
      if (in.picture) {
        close_gaps(in, out);
      } else {
        std::copy_n(in.values, elements, out);
      }
    });
    used(source);
  }

  void add_concatenation(const TfliteOperator& op) {
    const std::vector<int>& shape = tensor(result(op)).shape;
    const auto axis = static_cast<std::size_t>(op.axis);
    if (shape.size() == 4) {
      fail("concatenating images is not supported");
    }
    if (axis >= shape.size()) {
      fail("a concatenation has not the axis that it names");
    }
    std::size_t blocks = 1;
    for (std::size_t d = 0; d < axis; ++d) {
      blocks *= static_cast<std::size_t>(shape[d]);
    }
    std::vector<std::pair<const float*, std::size_t>> parts;  // and the floats of a block
    std::size_t elements = 0;
    for (std::size_t i = 0; i < op.inputs.size(); ++i) {
      const Place& part = place(operand(op, i));
      const std::size_t count = tensor(op.inputs[i]).element_count();
      if (part.picture || count % blocks != 0) {
        fail("a concatenation's operands do not fit together");
      }
      parts.emplace_back(part.values, count / blocks);
      elements += count;
    }
    float* const out = make_flat(result(op), elements);
    net_.steps.emplace_back([parts = std::move(parts), blocks, out] {
      float* to = out;
      for (std::size_t block = 0; block < blocks; ++block) {
        for (const auto& [values, size] : parts) {
          to = std::copy_n(values + block * size, size, to);
        }
      }
    });
    for (const int input : op.inputs) {
      used(input);
    }
  }

  const TfliteModel& model_;
  std::string name_;
  Program& net_;
  std::vector<Place> places_;       ///< [tensor]
  std::vector<int> uses_;           ///< [tensor] of which no step was made yet
  std::vector<bool> done_;          ///< [operator] with a convolution before it
  std::map<int, int> dequantized_;  ///< tensor -> the float16 constant it widens
};

}  // namespace

struct Network::Impl : Program {};

TfliteModel part_of(const TfliteModel& model, int input, const std::vector<int>& outputs,
                    const std::string& name) {
  TfliteModel part;
  part.tensors = model.tensors;
  part.inputs = {input};
  part.outputs = outputs;
  std::vector<char> needed(model.tensors.size(), 0);
  const auto mark = [&](int tensor) {
    if (tensor < 0 || static_cast<std::size_t>(tensor) >= needed.size()) {
      throw Error(ErrorKind::UnreadableInput, fmt::format("{}: it has no tensor {}", name, tensor));
    }
    needed[static_cast<std::size_t>(tensor)] = 1;
  };
  mark(input);
  std::for_each(outputs.begin(), outputs.end(), mark);
  needed[static_cast<std::size_t>(input)] = 0;
  for (auto op = model.operators.rbegin(); op != model.operators.rend(); ++op) {
    const bool used = std::any_of(op->outputs.begin(), op->outputs.end(), [&](int tensor) {
      return tensor != input && needed.at(static_cast<std::size_t>(tensor)) != 0;
    });
    if (used) {
      for (const int tensor : op->inputs) {
        if (tensor >= 0) {
          mark(tensor);
        }
      }
      part.operators.push_back(*op);
    }
  }
  std::reverse(part.operators.begin(), part.operators.end());
  return part;
}

Network::Network(const TfliteModel& model, const std::string& name, int channels)
    : impl_(std::make_unique<Impl>()) {
  NetBuilder(model, name, channels, *impl_);
}
Network::~Network() = default;
Network::Network(Network&&) noexcept = default;
Network& Network::operator=(Network&&) noexcept = default;

int Network::input_rows() const {
  return impl_->input_extents.rows;
}
int Network::input_columns() const {
  return impl_->input_extents.columns;
}
std::span<float> Network::input() {
  return impl_->input;
}
void Network::forward() {
  for (const std::function<void()>& step : impl_->steps) {
    step();
  }
}
std::span<const float> Network::output(std::size_t index) const {
  return impl_->outputs.at(index);
}
std::size_t Network::output_count() const {
  return impl_->outputs.size();
}

}  // namespace facet::landmark
