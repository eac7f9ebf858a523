// SPDX-License-Identifier: Apache-2.0
//
// Files of /proc and /sys as text. What cannot be read is empty.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace agnocast::ctl {

/// Returns the file's text, of at most 4 MiB.
std::string contents_of(const std::string& path);
/// The same of a file in an open directory.
std::string contents_at(int directory, const char* name);
/// Returns the path of a file in the process's directory of /proc.
std::string of_process(pid_t pid, const char* what);
/// Returns the number that the text begins with, after blanks.
std::optional<std::uint64_t> number_in(std::string_view text, int base = 10);
/// Returns the rest of the first line that begins with `key`.
std::string_view line_after(std::string_view text, std::string_view key);

}  // namespace agnocast::ctl
