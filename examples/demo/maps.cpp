// SPDX-License-Identifier: Apache-2.0

#include <examples/demo/maps.hpp>

#include <fstream>
#include <sstream>

namespace demo {

std::optional<MappedPlace> place_in(pid_t process, std::uint64_t address) {
  std::ifstream maps("/proc/" + std::to_string(process) + "/maps");
  for (std::string text; std::getline(maps, text);) {
    // begin-end permissions offset device inode name
    std::istringstream line(text);
    std::uint64_t begin = 0, end = 0, offset = 0;
    char dash = 0;
    MappedPlace place;
    line >> std::hex >> begin >> dash >> end >> place.permissions >> offset >> place.device >>
        std::dec >> place.inode;
    if (!line || address < begin || address >= end) continue;
    std::getline(line >> std::ws, place.name);
    place.offset = offset + (address - begin);
    return place;
  }
  return std::nullopt;
}

}  // namespace demo
