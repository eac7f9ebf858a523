// SPDX-License-Identifier: Apache-2.0

#include <bench/pipeline/inputs.hpp>

#include <bench/pipeline/scan_file.hpp>
#include <bench/pipeline/simulator.hpp>

#include <array>

namespace agnocast::bench::pipeline {

std::vector<Cloud> inputs_of(std::size_t lidar, std::size_t count, const std::string& scan) {
  const Lidar& of = lidars()[lidar];
  if (lidar == top_lidar && !scan.empty())
    return std::vector<Cloud>(count, read_scan(scan, of.frame));
  constexpr std::uint64_t street = 1;
  const Scene scene = make_scene(street);
  std::vector<Cloud> inputs;
  for (std::size_t i = 0; i < count; ++i) inputs.push_back(simulate(scene, of, i, {}));
  return inputs;
}

std::vector<Output> outputs_of(std::size_t count, const std::string& scan) {
  std::array<std::vector<Cloud>, lidar_count> inputs;
  for (std::size_t i = 0; i < lidar_count; ++i) inputs[i] = inputs_of(i, count, scan);
  std::vector<Output> outputs;
  for (std::size_t number = 0; number < count; ++number) {
    std::array<Cloud, lidar_count> clouds;
    std::array<Part, lidar_count> parts;
    for (std::size_t i = 0; i < lidar_count; ++i) {
      preprocess(lidars()[i], inputs[i][number], [&]() -> Cloud& { return clouds[i]; });
      parts[i] = {&clouds[i], lidars()[i].in_vehicle};
    }
    Cloud whole;
    concatenate(parts, whole);
    outputs.push_back({whole.width, checksum_of(whole), clouds[top_lidar].data.size()});
  }
  return outputs;
}

}  // namespace agnocast::bench::pipeline
