#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "facet/error.hpp"
#include "landmark/tflite_model.hpp"

/// Any bytes: an error, or a model whose every index and constant can be followed.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace facet::landmark;
  try {
    const TfliteModel model = parse_tflite({data, size}, "fuzz");
    for (const TfliteOperator& op : model.operators) {
      for (const int input : op.inputs) {
        if (input >= static_cast<int>(model.tensors.size())) {
          std::abort();
        }
      }
    }
    for (std::size_t t = 0; t < model.tensors.size(); ++t) {
      const TfliteTensor& tensor = model.tensors[t];
      if (tensor.data.empty() || tensor.type == TensorType::Other) {
        continue;
      }
      const std::size_t values = tensor.type == TensorType::Int32
                                     ? model.constant_ints(static_cast<int>(t)).size()
                                     : model.constant_floats(static_cast<int>(t)).size();
      if (values != tensor.element_count()) {
        std::abort();
      }
    }
  } catch (const facet::Error&) {
    return 0;
  }
  return 0;
}
