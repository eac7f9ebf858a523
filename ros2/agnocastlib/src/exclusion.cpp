// SPDX-License-Identifier: Apache-2.0
//
// Keeps the kernel-module system out of the process. That library defines classes of the same names
// (agnocast::Node, agnocast::Publisher<T>, …), of which the loader and the linker keep one, and its
// heap hook answers malloc instead of ours: a process with both writes into memory that it
// misunderstands. So it is ended as soon as this library is loaded beside it. A library that is
// loaded later is found when the next endpoint is created.

#include <agnocastlib/endpoints.hpp>

#include <dlfcn.h>
#include <link.h>
#include <unistd.h>

#include <atomic>
#include <cstring>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace agnocastlib {
namespace {

/// The heap hook of that system calls this function; no library of ours has it.
constexpr const char* function_of_other_system = "initialize_agnocast";

struct Loaded {
  unsigned long long loads = 0;         // of this process so far
  std::vector<std::string> candidates;  // paths
};

int look_at(dl_phdr_info* object, std::size_t, void* found) {
  auto& loaded = *static_cast<Loaded*>(found);
  loaded.loads = object->dlpi_adds;
  const std::string_view path = object->dlpi_name;
  const std::string_view name = path.substr(path.rfind('/') + 1);
  if (name.substr(0, 14) == "libagnocast.so") loaded.candidates.emplace_back(path);
  return 0;
}

/// Returns the path of the other system's library, or nothing if it is not loaded. `loads` changes
/// with every library that is loaded.
std::string find_other_system(unsigned long long& loads) {
  Loaded loaded;
  ::dl_iterate_phdr(look_at, &loaded);
  loads = loaded.loads;
  for (const std::string& path : loaded.candidates) {
    // This also finds the function in libraries that were loaded without RTLD_GLOBAL.
    void* const library = ::dlopen(path.c_str(), RTLD_LAZY | RTLD_NOLOAD);
    if (library == nullptr) continue;
    const bool is_found = ::dlsym(library, function_of_other_system) != nullptr;
    ::dlclose(library);
    if (is_found) return path;
  }
  return {};
}

std::string sentence_about(const std::string& library) {
  return "agnocast: the library of the kernel-module system (" + library +
         ") is in this process. It and agnocastlib over agnocast have the same names, and cannot "
         "be in one process: build everything that the process loads with one of them, and "
         "preload no heap hook of the other";
}

__attribute__((constructor)) void end_beside_other_system() {
  unsigned long long loads = 0;
  const std::string library = find_other_system(loads);
  if (library.empty()) return;
  const std::string line = sentence_about(library) + "\n";
  if (::write(STDERR_FILENO, line.data(), line.size()) < 0) {
    // Nobody can read it.
  }
  ::_exit(EXIT_FAILURE);
}

}  // namespace

void refuse_other_system() {
  static std::atomic<unsigned long long> seen{0};
  unsigned long long loads = 0;
  // The number of loads is that of the first object already.
  ::dl_iterate_phdr(
      [](dl_phdr_info* object, std::size_t, void* found) {
        *static_cast<unsigned long long*>(found) = object->dlpi_adds;
        return 1;
      },
      &loads);
  if (loads == seen.load(std::memory_order_relaxed)) return;
  const std::string library = find_other_system(loads);
  if (!library.empty()) throw std::runtime_error(sentence_about(library));
  seen.store(loads, std::memory_order_relaxed);
}

}  // namespace agnocastlib
