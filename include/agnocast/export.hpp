// SPDX-License-Identifier: Apache-2.0
//
// AGNOCAST_PUBLIC marks the exported symbols of libagnocast; all others are hidden.
#pragma once

#define AGNOCAST_PUBLIC __attribute__((visibility("default")))
