// SPDX-License-Identifier: Apache-2.0
//
// The precompiled headers of all tests, or of all targets of a group, belong to this program; it is
// never run.

int main() {}
