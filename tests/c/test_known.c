/* Known channels: which of a model's they are, and a model that has no others. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "attributes/model.h"

#define CHECK(condition) check((condition) != 0, #condition, __LINE__)

static void check(int holds, const char *condition, int line)
{
    if (holds)
        return;
    fprintf(stderr, "test_known.c:%d: %s\n", line, condition);
    exit(1);
}

static void *allocate(size_t size)
{
    void *block = calloc(size, 1);
    CHECK(block != NULL);
    return block;
}

static void test_which(void)
{
    clgs_channel *model = allocate(5 * sizeof *model);
    memset(model, 0, 5 * sizeof *model);
    model[3].coder = CLGS_MIXED;
    CHECK(clgs_attributes_known(model, 0) == 0 && clgs_attributes_known(model, 5) == 0);
    model[0].coder = model[2].coder = CLGS_KNOWN;
    CHECK(clgs_attributes_known(model, 4) == 1 && clgs_attributes_known(model, 3) == 1);
    CHECK(clgs_attributes_known(model, 5) == -1); /* channel 4 is not known */
    model[1].coder = CLGS_KNOWN;
    CHECK(clgs_attributes_known(model, 4) == -1);
    model[0].coder = CLGS_STATIC;
    CHECK(clgs_attributes_known(model, 1) == 0 && clgs_attributes_known(model, 2) == -1);
    free(model);
}

/* Known channels alone are no bytes, and stay as they are; none has taps. */
static void test_alone(void)
{
    clgs_channel again[2], model[2] = {{.centre = 5, .gain = 9, .coder = CLGS_KNOWN, .classes = 1},
                                       {.span = 1, .coder = CLGS_KNOWN, .classes = 1}};
    int32_t value[2] = {-3, INT32_MIN}, same[2] = {-3, INT32_MIN};
    uint8_t out[256];
    void *work = allocate(clgs_attributes_workspace(1, 2) + clgs_attributes_header_workspace());
    CHECK(clgs_attributes_encode(model, value, NULL, 1, 2, out, sizeof out, work) == 0);
    CHECK(clgs_attributes_decode(model, out, 0, value, NULL, 1, 2, work) == CLGS_OK);
    CHECK(clgs_attributes_decode(model, out, 1, value, NULL, 1, 2, work) == CLGS_ERROR_TRAILING);
    CHECK(memcmp(value, same, sizeof value) == 0);
    size_t size = clgs_attributes_header_write(model, 2, out, sizeof out, work);
    CHECK(clgs_attributes_header_read(out, size, again, 2, work) == CLGS_OK);
    CHECK(memcmp(again, model, sizeof model) == 0);
    model[1].taps = 1;
    CHECK(clgs_attributes_header_write(model, 2, out, sizeof out, work) == 0);
    CHECK(clgs_attributes_decode(model, out, 0, value, NULL, 1, 2, work) == CLGS_ERROR_ARGUMENT);
    free(work);
}

int main(void)
{
    test_which();
    test_alone();
    puts("known channels: all tests passed");
    return 0;
}
