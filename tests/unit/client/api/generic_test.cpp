// SPDX-License-Identifier: Apache-2.0
//
// Goal: a message type is found by its name in every place, equals the type that the compiler
// knows, and is copied as the compiler would copy it; an invalid name never becomes a path.
// Method: every message type of interfaces/ beside its C++ type; a program without message
// packages, in chosen environments.

#include <agnocast/generic.hpp>
#include <every_message.hpp>
#include <tests/support/machine/temporary_directory.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/shell.hpp>

#include <gmock/gmock.h>

#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using testing::AllOf;
using testing::EndsWith;
using testing::HasSubstr;
using testing::StartsWith;

TEST(Generic, EveryTypeEqualsTheOneThatTheCompilerKnows) {
  int count = 0;
  test::for_every_message([&](auto* null, const std::string& name) {
    using T = std::remove_pointer_t<decltype(null)>;
    const auto found = try_find_message_type(name);
    ASSERT_TRUE(found) << text_of(found.error());
    const auto generic = found->message_type();
    ASSERT_TRUE(generic) << name << ": " << text_of(generic.error());
    const auto typed = message_type_of<T>();
    ASSERT_TRUE(typed);
    EXPECT_EQ(generic->name(), name);
    EXPECT_EQ(generic->layout_hash(), typed->layout_hash()) << name;
    EXPECT_EQ(generic->message_bytes(), sizeof(T)) << name;
    EXPECT_EQ(generic->message_alignment(), alignof(T)) << name;
    ++count;
  });
  EXPECT_GE(count, 250);
}

TEST(Generic, ACopyByTheTableEqualsTheCompilersCopy) {
  // Without NaN, so that the types' own == works.
  test::RandomMessages random(7, {.has_nan = false, .has_any_text = true});
  test::for_every_message([&](auto* null, const std::string& name) {
    using T = std::remove_pointer_t<decltype(null)>;
    const IntrospectedType type = find_message_type(name);
    for (int round = 0; round < 20; ++round) {
      T original;
      random.fill(type.members(), &original);
      const OwnedGenericMessage copy = type.copy(&original);
      EXPECT_EQ(*reinterpret_cast<const T*>(copy.get()), original) << name;
      EXPECT_TRUE(test::are_same(type.members(), copy.get(), &original)) << name;
      T other;
      random.fill(type.members(), &other);
      EXPECT_TRUE(original == other || !test::are_same(type.members(), copy.get(), &other))
          << name << ": are_same overlooks a member";
    }
    const OwnedGenericMessage fresh = type.make();
    EXPECT_EQ(*reinterpret_cast<const T*>(fresh.get()), T())
        << name << ": does not have its defaults";
  });
}

TEST(Generic, TheKindMsgMayBeOmitted) {
  EXPECT_EQ(&find_message_type("sensor_msgs/PointCloud2").members(),
            &find_message_type("sensor_msgs/msg/PointCloud2").members());
  EXPECT_THROW(find_message_type("sensor_msgs/SetCameraInfo_Request"), Error);
}

TEST(Generic, AnInvalidNameIsRefusedBeforeAnySearch) {
  for (const char* const name : {"",
                                 "/",
                                 "//",
                                 "a",
                                 "String",
                                 "std_msgs/msg/",
                                 "/msg/String",
                                 "std_msgs//String",
                                 "std_msgs/msg/String/",
                                 "std_msgs/msg/x/String",
                                 "../std_msgs/msg/String",
                                 "std_msgs/msg/../String",
                                 "std-msgs/msg/String",
                                 "std_msgs/foo/String",
                                 "std_msgs/msg/String ",
                                 "std_msgs/msg/St\nring",
                                 "1std_msgs/msg/String",
                                 "std_msgs/msg/_String",
                                 "std_msgs::msg::String",
                                 "\xc3\xa9/msg/String"}) {
    const auto found = try_find_message_type(name);
    ASSERT_FALSE(found) << name;
    EXPECT_EQ(found.error().code, Errc::invalid_name) << name;
  }
  for (const std::string& name :
       {std::string("std_msgs/msg/String\0x", 21), std::string(100000, 'a') + "/msg/String",
        "std_msgs/msg/" + std::string(300, 'S')})
    EXPECT_EQ(try_find_message_type(name).error().code, Errc::invalid_name);
  EXPECT_EQ(text_of(try_find_message_type("\x1b[2Jno/type").error()),
            "a name is not a ROS 2 name: '?[2Jno/type' is no message type; one is like "
            "sensor_msgs/msg/PointCloud2");
}

TEST(Generic, ATypeMissingInItsLibraryIsReported) {
  const auto found = try_find_message_type("std_msgs/msg/Strin");
  ASSERT_FALSE(found);
  EXPECT_EQ(found.error().code, Errc::type_not_found);
  EXPECT_EQ(text_of(found.error()),
            "there is no support for a message type of this name: std_msgs/msg/Strin: "
            "libstd_msgs__rosidl_typesupport_introspection_cpp.so has no such type");
}

TEST(Generic, AForkedChildOfAProcessWithoutEndpointsMayLookForTypes) {
  test::Child child([] { return try_find_message_type("std_msgs/msg/String") ? 0 : 1; });
  EXPECT_EQ(child.wait(), 0);
}

// --- where a type is found: in a separate process

/// Runs the finder with these variables and no others.
test::ShellResult find(const std::vector<std::string>& variables, const std::string& arguments) {
  std::string command = "env -i ";
  for (const std::string& variable : variables) command += "'" + variable + "' ";
  return test::run_in_shell(command + AGNOCAST_TYPE_FINDER + " " + arguments);
}
std::string environment(const char* name) {
  const char* const value = std::getenv(name);
  return std::string(name) + '=' + (value != nullptr ? value : "");
}
constexpr const char* library = "libsensor_msgs__rosidl_typesupport_introspection_cpp.so";
constexpr const char* found = "PointCloud2, 9 members\n";

/// Returns lib/ of every prefix: in an overlay, each has only its own libraries.
std::string directories() {
  std::string text;
  std::string prefixes = environment("AMENT_PREFIX_PATH");
  prefixes.erase(0, prefixes.find('=') + 1);
  for (std::size_t end; !prefixes.empty(); prefixes.erase(0, end + (end < prefixes.size()))) {
    end = std::min(prefixes.find(':'), prefixes.size());
    text += " '" + prefixes.substr(0, end) + "/lib'";
  }
  return text;
}

TEST(Generic, TypesAreFoundAlongEachKindOfPath) {
  if (directories().empty()) GTEST_SKIP() << "AMENT_PREFIX_PATH is not set";
  EXPECT_EQ(find({environment("AMENT_PREFIX_PATH")}, "sensor_msgs/msg/PointCloud2").text, found)
      << "together with the libraries that this one needs";
  EXPECT_EQ(find({}, "sensor_msgs/msg/PointCloud2" + directories()).text, found);
  if (std::getenv("LD_LIBRARY_PATH") != nullptr) {
    EXPECT_EQ(find({environment("LD_LIBRARY_PATH")}, "sensor_msgs/msg/PointCloud2").text, found);
  }
  const auto nowhere = find({"AMENT_PREFIX_PATH=/nowhere:"}, "sensor_msgs/PointCloud2 /here");
  EXPECT_EQ(nowhere.status, 1);
  EXPECT_EQ(nowhere.text, std::string("there is no support for a message type of this name: "
                                      "sensor_msgs/msg/PointCloud2: no ") +
                              library + " in /here, /nowhere/lib, nor where the loader searches\n");
}

TEST(Generic, TheFirstLibraryCountsEvenIfItIsBroken) {
  if (directories().empty()) GTEST_SKIP() << "AMENT_PREFIX_PATH is not set";
  const test::TemporaryDirectory directory;
  std::ofstream(directory.path(library)) << "no library";
  const auto answer =
      find({environment("AMENT_PREFIX_PATH")}, "sensor_msgs/msg/PointCloud2 " + directory.path());
  EXPECT_EQ(answer.status, 1);
  EXPECT_THAT(answer.text, AllOf(StartsWith("there is no support"),
                                 HasSubstr(directory.path() + "/" + library + ": ")));
}

/// Returns the path of the library in the environment.
std::string library_path() {
  std::string where;
  std::istringstream all(directories());
  for (std::string path; all >> path;) {
    path = path.substr(1, path.size() - 2) + "/" + library;
    if (std::filesystem::exists(path)) where = path;
  }
  return where;
}

TEST(Generic, AMissingDependencyOfALibraryIsNamed) {
  if (directories().empty()) GTEST_SKIP() << "AMENT_PREFIX_PATH is not set";
  const test::TemporaryDirectory directory;
  std::filesystem::copy_file(library_path(), directory.path(library));
  const auto answer = find({}, "sensor_msgs/msg/PointCloud2 " + directory.path());
  EXPECT_EQ(answer.status, 1);
  EXPECT_THAT(answer.text, HasSubstr("geometry_msgs"));
  EXPECT_EQ(find({"LD_LIBRARY_PATH=" + directory.path()}, "sensor_msgs/msg/PointCloud2").text,
            answer.text)
      << "also if the loader has found the library";
}

TEST(Generic, ATypeThatWasNotFoundIsSearchedAgain) {
  if (directories().empty()) GTEST_SKIP() << "AMENT_PREFIX_PATH is not set";
  const test::TemporaryDirectory directory;
  // Directories that come to exist between the first search and the second one.
  std::string links, paths;
  std::istringstream all(directories());
  int count = 0;
  for (std::string path; all >> path; ++count) {
    const std::string link = directory.path(std::to_string(count));
    links += "/bin/ln -s " + path.substr(1, path.size() - 2) + " " + link + "; ";
    paths += " " + link;
  }
  const auto answer = find({}, "--then '" + links + "' sensor_msgs/msg/PointCloud2" + paths);
  EXPECT_EQ(answer.status, 0);
  // The list of directories is cut where the environment has many.
  EXPECT_THAT(answer.text,
              AllOf(HasSubstr(std::string("no ") + library + " in " + directory.path("0") + ", "),
                    EndsWith(found)));
}

TEST(Generic, ALibraryThatCouldNotBeLoadedIsTriedAgain) {
  if (directories().empty()) GTEST_SKIP() << "AMENT_PREFIX_PATH is not set";
  const test::TemporaryDirectory directory;
  const std::string broken = directory.path(library);
  std::ofstream(broken) << "no library";
  const auto answer =
      find({environment("AMENT_PREFIX_PATH")},
           "--then '/bin/rm " + broken + "' sensor_msgs/msg/PointCloud2 " + directory.path());
  EXPECT_EQ(answer.status, 0);
  EXPECT_THAT(answer.text, AllOf(HasSubstr(broken + ": "), EndsWith(found)));
}

}  // namespace
}  // namespace agnocast
