# facet_shaders(<target> FILES <*.comp under shaders/> ...): SPIR-V at build time, included files tracked, embedded as
# arrays. Written by drivers/gpu; see there for how a kernel is loaded.
