# One library target per room. A room's headers are reached as "<room>/<header>.hpp" through a folder that
# exposes that room alone, so an include of a room that the target does not link does not compile.

add_library(facet_options INTERFACE)
target_compile_options(facet_options INTERFACE -Wall -Wextra -Wshadow -Wconversion $<$<COMPILE_LANGUAGE:CXX>:-Wnon-virtual-dtor> -Werror
                       $<$<COMPILE_LANG_AND_ID:CXX,Clang>:-Wthread-safety>  # facet/thread_annotations.hpp
                       -fno-math-errno -fno-trapping-math)
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  # AVX2 and FMA: every x86-64 machine of the last ten years. facetd and facet check it at start.
  set(FACET_MARCH "x86-64-v3" CACHE STRING "Value of -march")
  if(FACET_MARCH)
    target_compile_options(facet_options INTERFACE "-march=${FACET_MARCH}")
  endif()
endif()
if(FACET_SANITIZE)
  # The address sanitizer finds null pointers too; checks of object size and type cost a third of the build and find
  # nothing at -O1. Alignment is checked where bytes from outside are read, in the rooms that have a fuzzer.
  set(fuzzed "$<BOOL:$<TARGET_PROPERTY:FACET_FUZZED>>")
  target_compile_options(facet_options INTERFACE "-fsanitize=${FACET_SANITIZE}" -fno-sanitize=null,object-size,vptr
                         "$<IF:${fuzzed},-fsanitize-coverage=inline-8bit-counters$<COMMA>pc-table$<COMMA>indirect-calls$<COMMA>trace-cmp,-fno-sanitize=alignment>"
                         -fno-omit-frame-pointer -fno-sanitize-recover=all -g1)
  target_link_options(facet_options INTERFACE "-fsanitize=${FACET_SANITIZE}")
  target_compile_definitions(facet_options INTERFACE FACET_SANITIZED=1)
endif()

# Outside headers read once for all files: where a whole tree is built from nothing (packaging/prepare, the sanitizers). A build
# without it holds each file to including what it names, and has objects that ccache knows in every checkout. One set for
# libraries and one for programs, whose code is positioned differently. GCC maps its set into memory and refuses one where a
# definition differs, as GoogleTest's do; Clang's may hold everything.
if(FACET_PRECOMPILE)
  find_package(Eigen3 3.4 REQUIRED NO_MODULE)
  find_package(fmt REQUIRED)
  target_link_libraries(facet_options INTERFACE fmt::fmt)  # its definitions are part of the headers
  set(outside <algorithm> <array> <atomic> <bit> <chrono> <cmath> <condition_variable> <filesystem> <fstream> <functional> <map>
      <memory> <mutex> <numeric> <optional> <random> <set> <span> <sstream> <string> <thread> <unordered_map> <vector>
      <Eigen/Core> <Eigen/Geometry> <fmt/format.h>)
  set(linked facet_options Eigen3::Eigen)
  if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
    find_package(CLI11 REQUIRED)
    find_package(GTest REQUIRED)
    find_package(nlohmann_json REQUIRED)
    list(APPEND outside <Eigen/Dense> <Eigen/SparseCholesky> <fmt/ranges.h> <nlohmann/json.hpp> <CLI/CLI.hpp> <gmock/gmock.h> <gtest/gtest.h>)
    list(APPEND linked nlohmann_json::nlohmann_json CLI11::CLI11 GTest::gmock GTest::gtest)
  endif()
  file(WRITE "${CMAKE_BINARY_DIR}/precompiled/empty.cpp" "int main() {}\n")
  add_library(facet_precompiled_library STATIC "${CMAKE_BINARY_DIR}/precompiled/empty.cpp")
  add_executable(facet_precompiled_program "${CMAKE_BINARY_DIR}/precompiled/empty.cpp")
  foreach(target facet_precompiled_library facet_precompiled_program)
    target_link_libraries(${target} PRIVATE ${linked})
    target_precompile_headers(${target} PRIVATE ${outside})
  endforeach()
endif()

# facet_precompiled(<target>): lets it use the headers that are read once.
function(facet_precompiled target)
  if(FACET_PRECOMPILE)
    get_target_property(type ${target} TYPE)
    string(TOLOWER "${type}" type)
    string(REGEX REPLACE "executable" "program" kind "${type}")
    string(REGEX REPLACE "static_library" "library" kind "${kind}")
    target_precompile_headers(${target} REUSE_FROM facet_precompiled_${kind})
  endif()
endfunction()

# Six files of a room compiled as one, which read what they include once and make each instance of a template once: where a whole
# tree is built from nothing, as with FACET_PRECOMPILE, and as with it a build without holds each file to what it names.
# Files behind APART are compiled alone: what they call by some name within themselves, another file of the room does too.
# GCC takes an Impl with members of an unnamed namespace for one that others may see, and warns of copies that it has joined.
if(FACET_TOGETHER AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  target_compile_options(facet_options INTERFACE $<$<COMPILE_LANGUAGE:CXX>:-Wno-subobject-linkage>
                         -Wno-array-bounds -Wno-stringop-overflow -Wno-stringop-overread -Wno-maybe-uninitialized)
endif()
function(facet_together target)
  set_target_properties(${target} PROPERTIES UNITY_BUILD ${FACET_TOGETHER} UNITY_BUILD_BATCH_SIZE 6)
  set_source_files_properties(${ARGN} TARGET_DIRECTORY ${target} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
endfunction()

# Lower rooms are added before those that include them: the order of the table in docs/architecture.md.
function(facet_require name)
  foreach(target ${ARGN})
    if(NOT TARGET ${target})
      message(FATAL_ERROR "${name} includes ${target}, which stands below it or is no room (CMakeLists.txt, docs/architecture.md)")
    endif()
  endforeach()
endfunction()

# facet_room(<name> SOURCES <files> [APART <files of these>] [ROOMS <rooms it includes in its headers>] [LIBS <external, public>]
#            [PRIVATE_ROOMS <rooms>] [PRIVATE_LIBS <external>])
function(facet_room name)
  cmake_parse_arguments(ARG "" "" "SOURCES;APART;ROOMS;LIBS;PRIVATE_ROOMS;PRIVATE_LIBS" ${ARGN})
  set(door "${CMAKE_BINARY_DIR}/rooms/${name}")
  file(MAKE_DIRECTORY "${door}")
  file(CREATE_LINK "${CMAKE_CURRENT_SOURCE_DIR}" "${door}/${name}" SYMBOLIC)
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  list(TRANSFORM ARG_PRIVATE_ROOMS PREPEND "facet_")
  facet_require(facet_${name} ${ARG_ROOMS} ${ARG_PRIVATE_ROOMS})
  if(ARG_SOURCES)
    add_library(facet_${name} STATIC ${ARG_SOURCES})
    target_include_directories(facet_${name} PUBLIC "${door}")
    target_link_libraries(facet_${name} PUBLIC ${ARG_ROOMS} ${ARG_LIBS}
                          PRIVATE facet_options ${ARG_PRIVATE_ROOMS} ${ARG_PRIVATE_LIBS})
    facet_precompiled(facet_${name})
    facet_together(facet_${name} ${ARG_APART})
  else()
    add_library(facet_${name} INTERFACE)
    target_include_directories(facet_${name} INTERFACE "${door}")
    target_link_libraries(facet_${name} INTERFACE ${ARG_ROOMS} ${ARG_LIBS})
  endif()
endfunction()

# facet_schema(<target> <file.fbs>): "<file>_generated.h" in the build folder, which only this target's .cpp files include.
function(facet_schema target file)
  find_program(FLATC flatc REQUIRED)
  get_filename_component(name "${file}" NAME_WE)
  set(out "${CMAKE_CURRENT_BINARY_DIR}/generated")
  add_custom_command(
    OUTPUT "${out}/${name}_generated.h"
    COMMAND "${FLATC}" --cpp --scoped-enums --no-prefix -o "${out}" "${CMAKE_CURRENT_SOURCE_DIR}/${file}"
    DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/${file}"
    COMMENT "FlatBuffers: ${file}"
    VERBATIM)
  target_sources(${target} PRIVATE "${out}/${name}_generated.h")
  target_include_directories(${target} SYSTEM PRIVATE "${out}")
endfunction()

# facet_test(<room> SOURCES <files> [APART <files of these>] [ROOMS <rooms>] [LIBS <external>] [TOGETHER <suites>]): one gtest program test_<room>,
# each case a ctest; of the suites named after TOGETHER, whose cases share something that takes long to make, each
# suite is one. ctest runs each with the Vulkan validation layers on, where they are installed.
function(facet_test name)
  cmake_parse_arguments(ARG "" "" "SOURCES;APART;ROOMS;LIBS;TOGETHER" ${ARGN})
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  add_executable(test_${name} ${ARG_SOURCES})
  target_link_libraries(test_${name} PRIVATE facet_options facet_test_support ${ARG_ROOMS} ${ARG_LIBS} GTest::gtest GTest::gmock GTest::gtest_main)
  facet_precompiled(test_${name})
  facet_together(test_${name} ${ARG_APART})
  set(properties TIMEOUT 900 ENVIRONMENT FACET_VULKAN_VALIDATION=1 ENVIRONMENT_MODIFICATION FACET_KERNEL_CACHE=set:)
  list(TRANSFORM ARG_TOGETHER APPEND ".*" OUTPUT_VARIABLE together)
  list(JOIN together ":" together)
  string(REGEX REPLACE "^(.+)$" "TEST_FILTER;-\\1" filter "${together}")
  gtest_discover_tests(test_${name} TEST_PREFIX "${name}." ${filter} DISCOVERY_MODE PRE_TEST
                       WORKING_DIRECTORY "${CMAKE_SOURCE_DIR}" DISCOVERY_TIMEOUT 120 PROPERTIES ${properties})
  foreach(suite ${ARG_TOGETHER})
    add_test(NAME ${name}.${suite} COMMAND test_${name} "--gtest_filter=${suite}.*" WORKING_DIRECTORY "${CMAKE_SOURCE_DIR}")
    set_tests_properties(${name}.${suite} PROPERTIES SKIP_REGULAR_EXPRESSION "\\[  SKIPPED \\]" ${properties})
  endforeach()
endfunction()

add_custom_target(fuzzers)

# facet_fuzzer(<name> SOURCES <files> ROOMS <rooms> LONGEST <bytes> [TEXT <dictionary>] [THREADS]): a libFuzzer program fuzz_<name>; its
# corpus is tests/fuzz/corpus/<name>. LONGEST: what the product reads at most, or where that is far more than a run can try, what
# it shall try. TEXT: a nested format, whose inputs are made deep and long too; its words are tests/fuzz/dictionaries/<dictionary>.
# THREADS: its threads come and go, which the search for leaks does not survive ("Tracer caught signal"): it is off.
# Beside the program lies fuzz_<name>.options, with which it is to be run. The rooms are compiled with coverage counters for it.
function(facet_fuzzer name)
  if(NOT FACET_FUZZ)
    return()
  endif()
  cmake_parse_arguments(ARG "THREADS" "LONGEST;TEXT" "SOURCES;ROOMS;LIBS" ${ARGN})
  if(NOT ARG_LONGEST)
    message(FATAL_ERROR "fuzz_${name} does not say how long its inputs may be (LONGEST)")
  endif()
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  set(options "-max_len=${ARG_LONGEST}\n")
  if(ARG_TEXT)
    list(APPEND ARG_SOURCES "${CMAKE_SOURCE_DIR}/tests/fuzz/repeat_mutator.cpp")
    string(APPEND options "-len_control=0\n-dict=${CMAKE_SOURCE_DIR}/tests/fuzz/dictionaries/${ARG_TEXT}\n")
  endif()
  if(ARG_THREADS)
    string(APPEND options "-detect_leaks=0\n")
  endif()
  file(GENERATE OUTPUT "${CMAKE_BINARY_DIR}/fuzzers/fuzz_${name}.options" CONTENT "${options}")
  add_executable(fuzz_${name} ${ARG_SOURCES})
  set_target_properties(fuzz_${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/fuzzers")
  add_dependencies(fuzzers fuzz_${name})
  target_link_libraries(fuzz_${name} PRIVATE facet_options ${ARG_ROOMS} ${ARG_LIBS})
  target_include_directories(fuzz_${name} PRIVATE "${CMAKE_SOURCE_DIR}/tests/support")  # what fuzzers share
  target_link_options(fuzz_${name} PRIVATE -fsanitize=fuzzer)
  facet_precompiled(fuzz_${name})
  foreach(room ${ARG_ROOMS})
    get_target_property(type ${room} TYPE)
    if(NOT type STREQUAL "INTERFACE_LIBRARY")
      set_target_properties(${room} PROPERTIES FACET_FUZZED ON)
    endif()
  endforeach()
endfunction()

# facet_program(<name> SOURCES <files> [ROOMS ...] [LIBS ...])
function(facet_program name)
  cmake_parse_arguments(ARG "" "" "SOURCES;ROOMS;LIBS" ${ARGN})
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE facet_options ${ARG_ROOMS} ${ARG_LIBS})
  facet_precompiled(${name})
  if(FACET_SANITIZE)
    target_sources(${name} PRIVATE "${CMAKE_SOURCE_DIR}/tests/support/sanitizer_defaults.cpp")
  endif()
endfunction()
