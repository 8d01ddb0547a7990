/* What the codec needs of <string.h> where there is no C library: memory.c defines it. */
#ifndef CLGS_WEB_STRING_H
#define CLGS_WEB_STRING_H

#include <stddef.h>

void *memcpy(void *to, const void *from, size_t size);
void *memmove(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);

#endif
