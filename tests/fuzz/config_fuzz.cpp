// SPDX-License-Identifier: Apache-2.0
//
// Goal: any text is a configuration or a list of mistakes with positions, never a crash; an
// accepted one can be printed and reads back equal.

#include <daemon/config/config.hpp>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace agnocast::daemon;
  NameLookup names;
  names.user = [](const std::string& name) {
    return name == "lidar" ? std::optional<uid_t>(1000) : std::nullopt;
  };
  names.group = [](const std::string& name) {
    return name == "perception" ? std::optional<gid_t>(2000) : std::nullopt;
  };
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const auto config = parse_config(text, "fuzz.toml", names);
  if (!config) {
    if (config.error().empty()) std::abort();
    for (const ConfigError& error : config.error()) {
      const std::string line = error.text();
      if (line.empty() || line.find('\n') != std::string::npos) std::abort();
    }
    return 0;
  }
  const auto again = parse_config(to_toml(*config), "again.toml", names);
  if (!again || !(*again == *config)) std::abort();
  return 0;
}
