// SPDX-License-Identifier: Apache-2.0

#include <daemon/process/child_process.hpp>

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <string>
#include <string_view>

namespace agnocast::daemon {

char state_of_first_thread(pid_t pid) noexcept {
  const UniqueFd file(
      ::open(("/proc/" + std::to_string(pid) + "/stat").c_str(), O_RDONLY | O_CLOEXEC));
  std::array<char, 512> text{};
  const ssize_t bytes = ::read(file.get(), text.data(), text.size());
  if (bytes <= 0) return 0;
  // "pid (name) state …": the name may contain anything.
  const std::string_view all(text.data(), static_cast<std::size_t>(bytes));
  const std::size_t name_end = all.rfind(") ");
  return name_end == std::string_view::npos || name_end + 2 >= all.size() ? '\0'
                                                                          : all[name_end + 2];
}

bool first_thread_has_ended(pid_t pid) noexcept { return state_of_first_thread(pid) == 'Z'; }

ProcessorTime processor_time_of(pid_t pid) noexcept {
  const UniqueFd file(
      ::open(("/proc/" + std::to_string(pid) + "/schedstat").c_str(), O_RDONLY | O_CLOEXEC));
  std::array<char, 128> text{};
  const ssize_t bytes = ::read(file.get(), text.data(), text.size() - 1);
  unsigned long long ran_ns = 0, waited_ns = 0;
  if (bytes <= 0 || std::sscanf(text.data(), "%llu %llu", &ran_ns, &waited_ns) != 2) return {};
  return {ran_ns, waited_ns};
}

}  // namespace agnocast::daemon
