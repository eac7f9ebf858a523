// SPDX-License-Identifier: Apache-2.0
//
// The rows of docs/recovery.md: the columns beside each label.
#pragma once

#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <string>
#include <vector>

namespace agnocast::test {

/// Returns label → other columns, without surrounding blanks. A duplicate label fails the test.
inline std::map<std::string, std::vector<std::string>> read_recovery_document() {
  std::map<std::string, std::vector<std::string>> rows;
  std::ifstream file(AGNOCAST_RECOVERY_DOCUMENT);
  EXPECT_TRUE(file) << AGNOCAST_RECOVERY_DOCUMENT;
  for (std::string line; std::getline(file, line);) {
    if (line.rfind("| @", 0) != 0) continue;
    std::vector<std::string> columns;
    for (std::size_t begin = 1; begin < line.size();) {
      std::size_t end = line.find('|', begin);
      if (end == std::string::npos) end = line.size();
      const std::string cell = line.substr(begin, end - begin);
      const std::size_t first = cell.find_first_not_of(' '), last = cell.find_last_not_of(' ');
      columns.push_back(first == std::string::npos ? "" : cell.substr(first, last - first + 1));
      begin = end + 1;
    }
    const std::string label = columns.front();
    columns.erase(columns.begin());
    EXPECT_TRUE(rows.emplace(label, columns).second) << label << " is in the document twice";
  }
  return rows;
}

}  // namespace agnocast::test
