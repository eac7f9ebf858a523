// SPDX-License-Identifier: Apache-2.0
#include <tests/support/json_judge.hpp>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include <cstdio>
#include <memory>
#include <sstream>

namespace agnocast::test {
namespace {

class Judge : public ::testing::Environment {
 public:
  void keep(const std::string& text) {
    if (const auto whole = nlohmann::json::parse(text, nullptr, false); !whole.is_discarded()) {
      lines_ += whole.dump() + '\n';
      return;
    }
    std::istringstream stream(text);
    for (std::string line; std::getline(stream, line);) {
      // The last line may be cut off, because its program was killed.
      if (stream.eof()) return;
      EXPECT_TRUE(nlohmann::json::accept(line)) << line;
      lines_ += line + '\n';
    }
  }

  void TearDown() override {
    if (lines_.empty()) return;
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::tmpfile(), std::fclose);
    ASSERT_NE(file, nullptr);
    std::fwrite(lines_.data(), 1, lines_.size(), file.get());
    std::rewind(file.get());
    const std::string tests = AGNOCAST_SOURCE_DIR "/tests/support/judge_json '" AGNOCAST_SOURCE_DIR
                                                  "/ctl/schemas' </dev/fd/";
    EXPECT_EQ(std::system((tests + std::to_string(::fileno(file.get()))).c_str()), 0)
        << "the output of agnocast-ctl --json does not match ctl/schemas";
  }

 private:
  std::string lines_;
};

// GoogleTest owns it.
Judge* const the_judge = [] {
  auto* const judge = new Judge;
  ::testing::AddGlobalTestEnvironment(judge);
  return judge;
}();

}  // namespace

void judge_json(const std::string& text) { the_judge->keep(text); }

}  // namespace agnocast::test
