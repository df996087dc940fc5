// The push constants of the test kernels, for shaders and host.
#ifndef FACET_TESTS_GPU_LAYOUT_H
#define FACET_TESTS_GPU_LAYOUT_H

#include "common/layout.h"

FACET_LAYOUT_BEGIN(test_gpu)

struct ScalePush {
  vec4 offset;
  uint count;
  float scale;
};
FACET_LAYOUT_SIZE(ScalePush, 32)
FACET_LAYOUT_OFFSET(ScalePush, offset, 0)
FACET_LAYOUT_OFFSET(ScalePush, count, 16)
FACET_LAYOUT_OFFSET(ScalePush, scale, 20)

struct CountPush {
  uint count;
};
FACET_LAYOUT_SIZE(CountPush, 4)

FACET_LAYOUT_END

#endif
