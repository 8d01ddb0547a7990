/* Memory in one piece that is given back from the end. */
#ifndef CLGS_WEB_MEMORY_H
#define CLGS_WEB_MEMORY_H

#include <stddef.h>

/* `size` bytes, aligned to 64, not initialised; NULL if there is no room. */
void *memory_take(size_t size);

/* Where the next block begins. */
size_t memory_mark(void);

/* Give back all blocks that were taken since `mark`. */
void memory_release(size_t mark);

#endif
