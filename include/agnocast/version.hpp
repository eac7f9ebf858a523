// SPDX-License-Identifier: Apache-2.0
//
// The only place of the version number: CMake, the package and the programs' --version read it
// from here.
#pragma once

#define AGNOCAST_VERSION_MAJOR 0
#define AGNOCAST_VERSION_MINOR 1
#define AGNOCAST_VERSION_PATCH 0
