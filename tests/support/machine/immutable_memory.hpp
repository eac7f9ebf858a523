// SPDX-License-Identifier: Apache-2.0
//
// Whether the kernel lets this process make a memfd immutable, asked without code of the product.
#pragma once

#include <linux/fs.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>

namespace agnocast::test {

/// Returns the error of the refusal; 0: it does not refuse.
inline int kernel_refuses_immutable_memory() {
  const int file = ::memfd_create("probe", MFD_CLOEXEC);
  int flags = 0;
  const bool was_read = ::ioctl(file, FS_IOC_GETFLAGS, &flags) == 0;
  flags |= FS_IMMUTABLE_FL;
  const int error = was_read && ::ioctl(file, FS_IOC_SETFLAGS, &flags) == 0 ? 0 : errno;
  ::close(file);
  return error;
}

}  // namespace agnocast::test
