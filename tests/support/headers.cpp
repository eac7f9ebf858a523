// SPDX-License-Identifier: Apache-2.0
//
// Whose precompiled headers all tests use; nothing runs it.

int main() {}
