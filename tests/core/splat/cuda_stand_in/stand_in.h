// Stand-ins for CUDA's built-ins, so that a C++ compiler can compile kernels and one CPU thread can run them.
//
// The threads of a block are coroutines. A thread runs until a barrier; when all threads that must meet there have arrived, they
// go on. A barrier that some threads of a block or warp miss ends the program with a message, as it would hang a graphics card.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ucontext.h>
#include <utility>
#include <vector>

struct Index {
    int x, y, z;
};
static Index threadIdx, blockIdx, blockDim;

#define __global__
#define __device__
#define __shared__ static
#define __launch_bounds__(threads)

namespace stand_in {

const int MOST = 1024, WARP = 32;
const size_t STACK = 1 << 16;
enum State { RUNNING, AT_WARP, AT_BLOCK, DONE };

// Switching by hand where we can: swapcontext asks the system each time, and a warp's sums need millions of switches.
#if defined(__x86_64__)
struct Context {
    void *stack;
};
extern "C" void stand_in_switch(void **from, void *to);
__asm__(".text\n.globl stand_in_switch\n.hidden stand_in_switch\n.type stand_in_switch,@function\nstand_in_switch:\n"
        "pushq %rbp\npushq %rbx\npushq %r12\npushq %r13\npushq %r14\npushq %r15\n"
        "movq %rsp, (%rdi)\nmovq %rsi, %rsp\n"
        "popq %r15\npopq %r14\npopq %r13\npopq %r12\npopq %rbx\npopq %rbp\nret\n");
static void change(Context &from, Context &to) {
    stand_in_switch(&from.stack, to.stack);
}
static void prepare(Context &context, char *stack, void (*body)()) {
    void **top = (void **)(stack + STACK) - 2;
    *--top = nullptr;  // the return address of a function that never returns; keeps the stack aligned
    *--top = (void *)body;
    for (int k = 0; k < 6; ++k) *--top = nullptr;
    context.stack = top;
}
#else
typedef ucontext_t Context;
static void change(Context &from, Context &to) {
    swapcontext(&from, &to);
}
static void prepare(Context &context, char *stack, void (*body)()) {
    getcontext(&context);
    context.uc_stack.ss_sp = stack;
    context.uc_stack.ss_size = STACK;
    context.uc_link = nullptr;
    makecontext(&context, body, 0);
}
#endif

static Context scheduler, contexts[MOST];
static State states[MOST];
static float given[MOST];
static int said[MOST];
static int current;
static void (*call)(void *);
static void *call_data;

static void wait(State state) {
    states[current] = state;
    change(contexts[current], scheduler);
}

static void body() {
    call(call_data);
    wait(DONE);
}

static bool all(int low, int high, State state, bool &any) {
    bool every = true;
    any = false;
    for (int k = low; k < high; ++k) {
        any = any || states[k] == state;
        every = every && states[k] == state;
    }
    return every;
}

static void run_block(int threads) {
    static std::vector<char> stacks(STACK * MOST);
    for (int k = 0; k < threads; ++k) {
        states[k] = RUNNING;
        prepare(contexts[k], stacks.data() + STACK * k, body);
    }
    while (true) {
        for (current = 0; current < threads; ++current) {
            if (states[current] != RUNNING) continue;
            threadIdx = {current, 0, 0};
            change(scheduler, contexts[current]);
        }
        bool any, moved = false;
        if (all(0, threads, DONE, any)) return;
        for (int low = 0; low < threads; low += WARP) {
            const int high = low + WARP < threads ? low + WARP : threads;
            if (all(low, high, AT_WARP, any)) {
                for (int k = low; k < high; ++k) states[k] = RUNNING;
                moved = true;
            }
        }
        if (!moved && all(0, threads, AT_BLOCK, any)) {
            for (int k = 0; k < threads; ++k) states[k] = RUNNING;
            moved = true;
        }
        if (!moved) {
            fprintf(stderr, "some threads of a block wait at a barrier that others do not reach\n");
            abort();
        }
    }
}

template <typename... Types, size_t... Numbers>
void run_grid(void (*kernel)(Types...), int blocks_x, int blocks_y, int threads, void **arguments, std::index_sequence<Numbers...>) {
    auto once = [&] { kernel(*(std::remove_const_t<Types> *)arguments[Numbers]...); };
    call = [](void *data) { (*(decltype(once) *)data)(); };
    call_data = &once;
    blockDim = {threads, 1, 1};
    for (int y = 0; y < blocks_y; ++y) {
        for (int x = 0; x < blocks_x; ++x) {
            blockIdx = {x, y, 0};
            run_block(threads);
        }
    }
}

template <typename... Types>
void launch(void (*kernel)(Types...), int blocks_x, int blocks_y, int threads, void **arguments) {
    run_grid(kernel, blocks_x, blocks_y, threads, arguments, std::index_sequence_for<Types...>());
}

}  // namespace stand_in

static void __syncthreads() {
    stand_in::wait(stand_in::AT_BLOCK);
}

static int __syncthreads_count(int predicate) {
    stand_in::said[stand_in::current] = predicate != 0;
    stand_in::wait(stand_in::AT_BLOCK);
    int total = 0;
    for (int k = 0; k < blockDim.x; ++k) total += stand_in::said[k];
    stand_in::wait(stand_in::AT_BLOCK);
    return total;
}

static int __any_sync(unsigned, int predicate) {
    stand_in::said[stand_in::current] = predicate != 0;
    stand_in::wait(stand_in::AT_WARP);
    const int low = stand_in::current / stand_in::WARP * stand_in::WARP;
    int any = 0;
    for (int k = low; k < low + stand_in::WARP; ++k) any |= stand_in::said[k];
    stand_in::wait(stand_in::AT_WARP);
    return any;
}

static float __shfl_xor_sync(unsigned, float value, int mask) {
    stand_in::given[stand_in::current] = value;
    stand_in::wait(stand_in::AT_WARP);
    const float got = stand_in::given[stand_in::current ^ mask];
    stand_in::wait(stand_in::AT_WARP);
    return got;
}
