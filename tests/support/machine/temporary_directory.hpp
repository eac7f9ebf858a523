// SPDX-License-Identifier: Apache-2.0
//
// A directory of one test, mode 0700, removed with everything in it.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

namespace agnocast::test {

class TemporaryDirectory {
 public:
  TemporaryDirectory() {
    std::string wanted = (std::filesystem::temp_directory_path() / "agnocast-XXXXXX").string();
    if (::mkdtemp(wanted.data()) == nullptr) std::abort();
    path_ = wanted;
  }
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;
  ~TemporaryDirectory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }

  const std::string& path() const { return path_; }
  std::string path(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

}  // namespace agnocast::test
