#pragma once

namespace facet::test {

/// The n-th thread (from 1) that this program makes from now on can't be made, once; 0: all can. Stands in
/// the place of the C library's pthread_create, whoever calls it. Not where a sanitizer makes the threads
/// (FACET_SANITIZED).
void refuse_thread(int n);

}  // namespace facet::test
