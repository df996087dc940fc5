// The push constants of the benchmarks' kernels, for shaders and host.
#ifndef FACET_BENCH_LAYOUT_H
#define FACET_BENCH_LAYOUT_H

#include "common/layout.h"

FACET_LAYOUT_BEGIN(gpu_facts)

struct CountPush {
  uint count;
};
FACET_LAYOUT_SIZE(CountPush, 4)

FACET_LAYOUT_END

#endif
