// Anything at all may come from the air. What is taken for a frame has one meaning: written again it gives
// the same bytes.
#include <stdlib.h>
#include <string.h>

#include "frame.h"

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  struct frame frame;
  if (!frame_read(data, size, &frame)) return 0;
  uint8_t bytes[FRAME_MAX];
  if (frame_write(&frame, bytes) != size || memcmp(bytes, data, size) != 0) abort();
  return 0;
}
