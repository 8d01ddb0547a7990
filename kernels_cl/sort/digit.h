/* One digit of a key, for radix sorts. */
#ifndef CLGS_DIGIT_H
#define CLGS_DIGIT_H

static inline int digit_of(uint key, int shift, uint mask)
{
    return (int)((key >> shift) & mask);
}

#endif
