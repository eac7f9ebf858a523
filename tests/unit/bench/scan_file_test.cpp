// SPDX-License-Identifier: Apache-2.0
//
// Recorded scans: reading returns what was written, and the refusal of a bad file says what is
// wrong, where, and what to do.

#include <bench/pipeline/scan_file.hpp>

#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace agnocast::bench::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class ScanFile : public testing::Test {
 protected:
  ScanFile() {
    std::string pattern = testing::TempDir() + "scan-XXXXXX";
    directory_ = ::mkdtemp(pattern.data());
  }
  ~ScanFile() override { std::filesystem::remove_all(directory_); }

  std::string write(const std::vector<float>& values, std::size_t fewer_bytes = 0) const {
    const std::string path = directory_ + "/scan.bin";
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(values.data()),
               static_cast<std::streamsize>(values.size() * sizeof(float) - fewer_bytes));
    return path;
  }
  static std::string refusal_of(const std::string& path) {
    try {
      (void)read_scan(path, "lidar_top");
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "(it was read)";
  }
  std::string directory_;
};

const std::vector<float> two_points{1, 2, 3, 40, 0, -4, 5.5f, 6, 70, 31};

TEST_F(ScanFile, IsReadAsItWasWritten) {
  const Cloud cloud = read_scan(write(two_points), "lidar_top");
  ASSERT_TRUE(is_of_points(cloud));
  EXPECT_EQ(cloud.header.frame_id, "lidar_top");
  ASSERT_EQ(cloud.width, 2u);
  const Point first = point_at(cloud, 0), second = point_at(cloud, 1);
  EXPECT_EQ(first.x, 1);
  EXPECT_EQ(first.y, 2);
  EXPECT_EQ(first.z, 3);
  EXPECT_EQ(first.intensity, 40);
  EXPECT_EQ(first.ring, 0);
  EXPECT_EQ(first.time_ns, 0u);
  EXPECT_EQ(second.x, -4);
  EXPECT_EQ(second.y, 5.5f);
  EXPECT_EQ(second.ring, 31);
  EXPECT_EQ(second.time_ns, 50'000'000u);  // half a revolution of 100 ms
}

TEST_F(ScanFile, ThatIsTruncatedIsRefused) {
  EXPECT_THAT(refusal_of(write(two_points, 3)),
              AllOf(HasSubstr(directory_), HasSubstr("at byte 20, has 17 of 20 bytes"),
                    HasSubstr("give a file")));
  EXPECT_THAT(refusal_of(write({})), AllOf(HasSubstr("it is empty"), HasSubstr("give a file")));
}

TEST_F(ScanFile, ThatDoesNotExistIsRefused) {
  EXPECT_THAT(refusal_of(directory_ + "/none"),
              AllOf(HasSubstr("/none"), HasSubstr("No such file"), HasSubstr("another file")));
  EXPECT_THAT(refusal_of(directory_), HasSubstr("no regular file"));
}

TEST_F(ScanFile, WithInvalidValuesIsRefused) {
  const auto with = [&](std::size_t index, float value) {
    std::vector<float> values = two_points;
    values[index] = value;
    return refusal_of(write(values));
  };
  EXPECT_THAT(with(5, std::numeric_limits<float>::quiet_NaN()),
              HasSubstr("point 1, at byte 20, has a value that is no number"));
  EXPECT_THAT(with(3, std::numeric_limits<float>::infinity()), HasSubstr("point 0, at byte 0"));
  EXPECT_THAT(with(9, -1), HasSubstr("ring"));
  EXPECT_THAT(with(9, 1.5f), HasSubstr("ring"));
  EXPECT_THAT(with(9, 1e9f), HasSubstr("ring"));
  EXPECT_THAT(with(9, std::numeric_limits<float>::quiet_NaN()), HasSubstr("ring"));
}

// Reads a recorded scan, if there is one.
TEST_F(ScanFile, RecordedByNuScenesIsRead) {
  const char* const folder = std::getenv("AGNOCAST_DATA_DIR");
  const std::string path = std::string(folder == nullptr ? "" : folder) + "/lidar_top_nuscenes.bin";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "needs a recorded scan in AGNOCAST_DATA_DIR";
  const Cloud cloud = read_scan(path, "lidar_top");
  EXPECT_EQ(cloud.width, 34'688u);
  for (std::size_t i = 0; i < cloud.width; ++i) ASSERT_LT(point_at(cloud, i).ring, 32);
}

}  // namespace
}  // namespace agnocast::bench::pipeline
