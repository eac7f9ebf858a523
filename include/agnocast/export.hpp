// SPDX-License-Identifier: Apache-2.0
//
// AGNOCAST_PUBLIC marks what libagnocast exports; everything else is hidden.
#pragma once

#define AGNOCAST_PUBLIC __attribute__((visibility("default")))
