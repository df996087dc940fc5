# Compute kernels: GLSL to SPIR-V at build time, with included files tracked, embedded in the binary as arrays.

# facet_shaders(<target> FILES <*.comp below the root> ... [ROOT <folder>])
#
# The root is shaders/ unless given. <target> gets "<room>_shaders.hpp" (facet_refine: "refine_shaders.hpp"), in which
# facet::shaders::<room>::kernels() is the room's gpu::ShaderSet; a kernel's name is its path below the root without
# its ending. Shaders may include "<file>" from their own folder and "common/<file>" from shaders/. Hosts include
# layouts shared with shaders as "shaders/<room>/layout.h".
#
# Binding numbers are given out by the compiler (--auto-map-bindings): shader and host know names only. The
# optimiser (-Os) inlines and drops what a kernel declares but does not use.
function(facet_shaders target)
  cmake_parse_arguments(ARG "" "ROOT" "FILES" ${ARGN})
  find_program(FACET_GLSLANG glslangValidator REQUIRED)
  set(shaders "${CMAKE_SOURCE_DIR}/shaders")
  if(NOT ARG_ROOT)
    set(ARG_ROOT "${shaders}")
  endif()
  string(REGEX REPLACE "^facet_" "" room "${target}")
  set(out "${CMAKE_BINARY_DIR}/shaders/${room}")
  set(includes "")
  set(table "")
  set(arrays "")
  foreach(file ${ARG_FILES})
    string(REGEX REPLACE "\\.comp$" "" name "${file}")
    string(MAKE_C_IDENTIFIER "${name}_words" array)
    get_filename_component(folder "${out}/${name}" DIRECTORY)
    get_filename_component(source_folder "${ARG_ROOT}/${file}" DIRECTORY)
    file(MAKE_DIRECTORY "${folder}")
    add_custom_command(
      OUTPUT "${out}/${name}.inc"
      COMMAND "${FACET_GLSLANG}" --quiet -V -Os --target-env vulkan1.2 --auto-map-bindings "-I${source_folder}" "-I${shaders}"
              --depfile "${out}/${name}.d" --vn "${array}" -o "${out}/${name}.inc" "${ARG_ROOT}/${file}"
      DEPENDS "${ARG_ROOT}/${file}"
      DEPFILE "${out}/${name}.d"
      COMMENT "Kernel ${room}: ${name}"
      VERBATIM)
    list(APPEND arrays "${out}/${name}.inc")
    string(APPEND includes "#include \"${name}.inc\"\n")
    string(APPEND table "    {\"${name}\", ${array}},\n")
  endforeach()
  file(CONFIGURE OUTPUT "${out}/${room}_shaders.hpp" CONTENT [[
#pragma once

#include "gpu/kernel.hpp"

namespace facet::shaders::@room@ {

/// Every kernel of this room.
facet::gpu::ShaderSet kernels();

}  // namespace facet::shaders::@room@
]] @ONLY)
  file(CONFIGURE OUTPUT "${out}/${room}_shaders.cpp" CONTENT [[
#include "@room@_shaders.hpp"

#include <cstdint>

namespace {
@includes@
const facet::gpu::Shader table[] = {
@table@};
}  // namespace

facet::gpu::ShaderSet facet::shaders::@room@::kernels() {
  return table;
}
]] @ONLY)
  set_source_files_properties("${out}/${room}_shaders.cpp" PROPERTIES OBJECT_DEPENDS "${arrays}")
  # The door shows hosts "shaders/<room>/layout.h" and the "common/layout.h" that those include.
  set(door "${CMAKE_BINARY_DIR}/rooms/shaders")
  file(MAKE_DIRECTORY "${door}")
  file(CREATE_LINK "${shaders}" "${door}/shaders" SYMBOLIC)
  file(CREATE_LINK "${shaders}/common" "${door}/common" SYMBOLIC)
  target_sources(${target} PRIVATE "${out}/${room}_shaders.cpp" ${arrays})
  target_include_directories(${target} PRIVATE "${out}" PUBLIC "${door}")
endfunction()
