// SPDX-License-Identifier: Apache-2.0

#include <ctl/snapshot/proc_files.hpp>

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <system_error>

namespace agnocast::ctl {
namespace {

// Bound for files whose length others choose: environment and mappings of a process.
constexpr std::size_t file_bytes_max = std::size_t{4} << 20;

}  // namespace

std::string contents_at(int directory, const char* name) {
  const UniqueFd file(::openat(directory, name, O_RDONLY | O_CLOEXEC));
  std::string text;
  std::array<char, 16384> buffer;
  while (file && text.size() < file_bytes_max) {
    const ssize_t count = ::read(file.get(), buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) break;
    text.append(buffer.data(), static_cast<std::size_t>(count));
  }
  return text;
}

std::string contents_of(const std::string& path) { return contents_at(AT_FDCWD, path.c_str()); }

std::string of_process(pid_t pid, const char* what) {
  return "/proc/" + std::to_string(pid) + '/' + what;
}

std::optional<std::uint64_t> number_in(std::string_view text, int base) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  std::uint64_t number = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), number, base);
  if (parsed.ec != std::errc()) return std::nullopt;
  return number;
}

std::string_view line_after(std::string_view text, std::string_view key) {
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string_view line = text.substr(at, end - at);
    if (line.starts_with(key)) return line.substr(key.size());
    at = end + 1;
  }
  return {};
}

}  // namespace agnocast::ctl
