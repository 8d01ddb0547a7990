/* A list of ascending numbers, as runs [begin, end) that do not touch. */
#ifndef CLGS_MLP_BLOCK_RUNS_H
#define CLGS_MLP_BLOCK_RUNS_H

#include "common/method.h"
#include "mlp/batch.h"
#include "mlp/layout.h"

/* Enough for the slots of a block, and for the blocks of a batch. */
#define MAX_RUNS (BATCH / BLOCK / 2 + K_OFFSETS / 2 + 1)
typedef struct {
    int count;
    int begin[MAX_RUNS], end[MAX_RUNS];
} Runs;

/* Appends the numbers [begin, end), which follow all others. */
static inline void add_run(Runs *runs, const int begin, const int end)
{
    if (runs->count > 0 && runs->end[runs->count - 1] == begin) {
        runs->end[runs->count - 1] = end;
    } else {
        runs->begin[runs->count] = begin;
        runs->end[runs->count++] = end;
    }
}

#endif
