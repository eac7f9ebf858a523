// SPDX-License-Identifier: Apache-2.0

#include <config/toml_file.hpp>

#include <base/descriptors/unique_fd.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <array>
#include <cerrno>

namespace agnocast::config {

tl::expected<std::string, int> read_file(const std::string& path) {
  const UniqueFd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd) return tl::unexpected(errno);
  std::string text;
  std::array<char, 4096> buffer;
  for (;;) {
    const ssize_t bytes = ::read(fd.get(), buffer.data(), buffer.size());
    if (bytes < 0 && errno == EINTR) continue;
    if (bytes < 0) return tl::unexpected(errno);
    if (bytes == 0) return text;
    text.append(buffer.data(), static_cast<std::size_t>(bytes));
    if (text.size() > file_bytes_max) return tl::unexpected(EFBIG);
  }
}

tl::expected<toml::table, Mistake> parse_toml(std::string_view text, const std::string& file,
                                              std::string remedy) {
  try {
    return toml::parse(text);
  } catch (const toml::parse_error& error) {
    const toml::source_position& place = error.source().begin;
    return tl::unexpected(Mistake{file, static_cast<std::uint32_t>(place.line),
                                  static_cast<std::uint32_t>(place.column), "",
                                  std::string(error.description()), std::move(remedy)});
  }
}

}  // namespace agnocast::config
