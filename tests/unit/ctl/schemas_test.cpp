// SPDX-License-Identifier: Apache-2.0
//
// Goal: exactly the JSON schemas that agnocast-ctl names are installed, and every reference in
// them resolves. Method: names in the sources against ctl/schemas. The tests that print JSON
// validate it (tests/support/json_judge.hpp).

#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <regex>
#include <set>
#include <string>

namespace agnocast::ctl {
namespace {

namespace fs = std::filesystem;
const fs::path folder = AGNOCAST_SOURCE_DIR "/ctl";

std::string text_of(const fs::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::map<std::string, nlohmann::json> schemas() {
  std::map<std::string, nlohmann::json> all;
  for (const auto& entry : fs::directory_iterator(folder / "schemas")) {
    const auto schema = nlohmann::json::parse(text_of(entry.path()));
    all.emplace(schema.at("$id").get<std::string>(), schema);
  }
  return all;
}

TEST(Schemas, AreExactlyThoseThatTheSourcesName) {
  std::set<std::string> named{"urn:agnocast:common:1"}, installed;
  const std::regex name("\"agnocast\\.([a-z-]+)/([0-9]+)\"");
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.path().extension() != ".cpp") continue;
    const std::string text = text_of(entry.path());
    for (std::sregex_iterator i(text.begin(), text.end(), name), end; i != end; ++i)
      named.insert("urn:agnocast:" + (*i)[1].str() + ':' + (*i)[2].str());
  }
  for (const auto& [id, schema] : schemas()) {
    installed.insert(id);
    if (!schema.contains("properties")) continue;  // a schema of shared definitions
    std::string constant = schema["properties"]["schema"]["const"];
    EXPECT_EQ(id, "urn:" + constant.replace(8, 1, ":").replace(constant.find('/'), 1, ":"));
  }
  EXPECT_EQ(named, installed);
}

void each_reference(const nlohmann::json& part,
                    const std::function<void(const std::string&)>& visit) {
  if (part.is_object() && part.contains("$ref")) visit(part["$ref"]);
  if (part.is_structured()) {
    for (const auto& inner : part) each_reference(inner, visit);
  }
}

TEST(Schemas, ReferToExistingDefinitions) {
  const auto all = schemas();
  for (const auto& [key, schema] : all) {
    const std::string& id = key;  // clang 14 captures no structured binding
    each_reference(schema, [&](const std::string& reference) {
      const auto hash = reference.find('#');
      const auto found = all.find(hash == 0 ? id : reference.substr(0, hash));
      ASSERT_NE(found, all.end()) << id << ": " << reference;
      if (hash == std::string::npos) return;
      EXPECT_TRUE(found->second.contains(nlohmann::json::json_pointer(reference.substr(hash + 1))))
          << id << ": " << reference;
    });
  }
}

}  // namespace
}  // namespace agnocast::ctl
