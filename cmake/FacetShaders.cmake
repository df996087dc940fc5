# Compute kernels: GLSL to SPIR-V at build time, with included files tracked, embedded in the binary as arrays with a table
# of what each kernel declares.

# facet_shaders(<target> FILES <*.comp below the root> ... [ROOT <folder>])
#
# The root is shaders/ unless given. <target> gets "<room>_shaders.hpp" (facet_refine: "refine_shaders.hpp"), in which
# facet::shaders::<room>::kernels() is the room's gpu::ShaderSet; a kernel's name is its path below the root without
# its ending. Shaders may include "<file>" from their own folder and "common/<file>" from shaders/. Hosts include
# layouts shared with shaders as "shaders/<room>/layout.h".
#
# Binding numbers are given out by the compiler (--auto-map-bindings): shader and host know names only. The
# optimiser (-Os) inlines and drops what a kernel declares but does not use. Names, kinds and sizes come from
# spirv-cross; cmake/embed-kernels refuses a kernel in which two resources have one name.
function(facet_shaders target)
  cmake_parse_arguments(ARG "" "ROOT" "FILES" ${ARGN})
  find_program(FACET_GLSLANG glslangValidator REQUIRED)
  find_program(FACET_SPIRV_CROSS spirv-cross REQUIRED)
  find_package(Python3 3.9 REQUIRED COMPONENTS Interpreter)
  set(shaders "${CMAKE_SOURCE_DIR}/shaders")
  if(NOT ARG_ROOT)
    set(ARG_ROOT "${shaders}")
  endif()
  string(REGEX REPLACE "^facet_" "" room "${target}")
  set(out "${CMAKE_BINARY_DIR}/shaders/${room}")
  set(names "")
  set(reflected "")
  foreach(file ${ARG_FILES})
    string(REGEX REPLACE "\\.comp$" "" name "${file}")
    get_filename_component(folder "${out}/${name}" DIRECTORY)
    get_filename_component(source_folder "${ARG_ROOT}/${file}" DIRECTORY)
    file(MAKE_DIRECTORY "${folder}")
    add_custom_command(
      OUTPUT "${out}/${name}.spv" "${out}/${name}.json"
      COMMAND "${FACET_GLSLANG}" --quiet -V -Os --target-env vulkan1.2 --auto-map-bindings "-I${source_folder}" "-I${shaders}"
              --depfile "${out}/${name}.d" -o "${out}/${name}.spv" "${ARG_ROOT}/${file}"
      COMMAND "${FACET_SPIRV_CROSS}" "${out}/${name}.spv" --reflect --output "${out}/${name}.json"
      DEPENDS "${ARG_ROOT}/${file}"
      DEPFILE "${out}/${name}.d"
      COMMENT "Kernel ${room}: ${name}"
      VERBATIM)
    list(APPEND reflected "${out}/${name}.json")
    list(APPEND names "${name}")
  endforeach()
  set(embed "${CMAKE_SOURCE_DIR}/cmake/embed-kernels")
  add_custom_command(
    OUTPUT "${out}/${room}_shaders.cpp"
    COMMAND Python3::Interpreter "${embed}" "${room}" "${out}" "${out}/${room}_shaders.cpp" ${names}
    DEPENDS "${embed}" ${reflected}
    COMMENT "Kernels of ${room}"
    VERBATIM)
  file(CONFIGURE OUTPUT "${out}/${room}_shaders.hpp" CONTENT [[
#pragma once

#include "gpu/shader.hpp"

namespace facet::shaders::@room@ {

/// Every kernel of this room.
facet::gpu::ShaderSet kernels();

}  // namespace facet::shaders::@room@
]] @ONLY)
  # The door shows hosts "shaders/<room>/layout.h" and the "common/layout.h" that those include.
  set(door "${CMAKE_BINARY_DIR}/rooms/shaders")
  file(MAKE_DIRECTORY "${door}")
  file(CREATE_LINK "${shaders}" "${door}/shaders" SYMBOLIC)
  file(CREATE_LINK "${shaders}/common" "${door}/common" SYMBOLIC)
  target_sources(${target} PRIVATE "${out}/${room}_shaders.cpp")
  target_include_directories(${target} PRIVATE "${out}" PUBLIC "${door}")
endfunction()
