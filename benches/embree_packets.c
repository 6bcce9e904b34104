// Embree's single rays and packets of 16 on one thread, for benches/render_visibility.py --packets.
//
// usage: embree_packets LIBRARY VERTICES TRIANGLES VIEWS REPEATS [coherent]
// LIBRARY is Embree 4, loaded while running: the one that embreex brings has no headers, so what is needed of
// its interface is declared here. VERTICES are three f32 each, TRIANGLES three u32; VIEWS lines of twelve
// numbers: eye, axis to the right, down and ahead, of a pinhole of 2048x1536 pixels, 1600 pixels its focal
// length. Prints a line for each view: pixels hit by single rays and by packets, those of different triangles,
// then the CPU seconds that single rays and packets take, each for triangle numbers alone and for all of depth,
// normal, weights and triangle. Rays are made and answers stored within that time, as in ours.

#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { WIDTH = 2048, HEIGHT = 1536, PIXELS = WIDTH * HEIGHT, LANES = 16, SIDE = 4 };
enum { ROBUST = 1 << 2, TRIANGLES = 0, INDICES = 0, VERTICES = 1, UINT3 = 0x5003, FLOAT3 = 0x9003 };
enum { NATIVE_16 = 34, COHERENT = 1 << 16 };
#define NOTHING UINT32_MAX

// One ray and what it meets; sixteen side by side. Room is left for what newer versions add at the end.
typedef struct {
    float from[3], near, to[3], time, far;
    uint32_t mask, id, flags;
    float normal[3], u, v;
    uint32_t triangle, geometry, instances[15];
} __attribute__((aligned(64))) Single;
typedef struct {
    float from[3][LANES], near[LANES], to[3][LANES], time[LANES], far[LANES];
    uint32_t mask[LANES], id[LANES], flags[LANES];
    float normal[3][LANES], u[LANES], v[LANES];
    uint32_t triangle[LANES], geometry[LANES], instances[7][LANES];
} __attribute__((aligned(64))) Packet;
typedef struct {
    uint32_t flags, features;
    void *context, *filter, *intersect;
    void *more[4];
} Arguments;
typedef struct {
    float from[3], right[3], down[3], ahead[3];
} View;
// What is seen of every pixel, as in ours: 28 bytes.
typedef struct {
    float *depth, *normal, *weights;
    uint32_t *triangle;
} Maps;

static void *library;
static void *scene;
static Arguments arguments = {0, UINT32_MAX, 0, 0, 0, {0}};
static void (*intersect1)(void *, Single *, Arguments *);
static void (*intersect16)(const int32_t *, void *, Packet *, Arguments *);

static void stop(const char *what, const char *which) {
    fprintf(stderr, "embree_packets: %s %s\n", what, which);
    exit(1);
}

static void *call(const char *name) {
    void *found = dlsym(library, name);
    if (!found) stop("the library has no", name);
    return found;
}

static char *read_all(const char *path, size_t *bytes) {
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END)) stop("cannot read", path);
    *bytes = (size_t)ftell(file);
    rewind(file);
    char *all = malloc(*bytes + 1);
    if (fread(all, 1, *bytes, file) != *bytes) stop("cannot read", path);
    fclose(file);
    return all;
}

static void fill(void *geometry, int kind, int format, const char *path) {
    void *(*room)(void *, int, unsigned, int, size_t, size_t) = call("rtcSetNewGeometryBuffer");
    size_t bytes;
    char *all = read_all(path, &bytes);
    memcpy(room(geometry, kind, 0, format, 12, bytes / 12), all, bytes);
    free(all);
}

static double now(void) {
    struct timespec at;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &at);
    return (double)at.tv_sec + 1e-9 * (double)at.tv_nsec;
}

static inline float along(const View *view, int axis, int column, int row) {
    float x = ((float)column + 0.5f - 1024.0f) / 1600.0f, y = ((float)row + 0.5f - 768.0f) / 1600.0f;
    return x * view->right[axis] + y * view->down[axis] + view->ahead[axis];
}

static void singles(const View *view, int all, Maps to) {
    for (int row = 0; row < HEIGHT; row++)
        for (int column = 0; column < WIDTH; column++) {
            Single ray = {.far = INFINITY, .mask = UINT32_MAX, .triangle = NOTHING, .geometry = NOTHING};
            for (int axis = 0; axis < 3; axis++) {
                ray.from[axis] = view->from[axis];
                ray.to[axis] = along(view, axis, column, row);
            }
            ray.instances[0] = NOTHING;
            intersect1(scene, &ray, &arguments);
            size_t at = (size_t)row * WIDTH + column;
            to.triangle[at] = ray.triangle;
            if (!all) continue;
            to.depth[at] = ray.far;
            memcpy(to.normal + 3 * at, ray.normal, sizeof ray.normal);
            to.weights[2 * at] = ray.u;
            to.weights[2 * at + 1] = ray.v;
        }
}

static void packets(const View *view, int all, Maps to) {
    int32_t valid[LANES] __attribute__((aligned(64)));
    memset(valid, -1, sizeof valid);
    for (int top = 0; top < HEIGHT; top += SIDE)
        for (int left = 0; left < WIDTH; left += SIDE) {
            Packet rays;
            for (int i = 0; i < LANES; i++) {
                for (int axis = 0; axis < 3; axis++) {
                    rays.from[axis][i] = view->from[axis];
                    rays.to[axis][i] = along(view, axis, left + i % SIDE, top + i / SIDE);
                }
                rays.near[i] = rays.time[i] = 0.0f;
                rays.far[i] = INFINITY;
                rays.mask[i] = UINT32_MAX;
                rays.id[i] = rays.flags[i] = 0;
                rays.triangle[i] = rays.geometry[i] = rays.instances[0][i] = NOTHING;
            }
            intersect16(valid, scene, &rays, &arguments);
            for (int i = 0; i < LANES; i++) {
                size_t at = (size_t)(top + i / SIDE) * WIDTH + left + i % SIDE;
                to.triangle[at] = rays.triangle[i];
                if (!all) continue;
                to.depth[at] = rays.far[i];
                for (int axis = 0; axis < 3; axis++) to.normal[3 * at + axis] = rays.normal[axis][i];
                to.weights[2 * at] = rays.u[i];
                to.weights[2 * at + 1] = rays.v[i];
            }
        }
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(int repeats, void (*work)(const View *, int, Maps), const View *view, int all, Maps to) {
    double *times = malloc(sizeof(double) * (size_t)repeats);
    work(view, all, to);
    for (int i = 0; i < repeats; i++) {
        double start = now();
        work(view, all, to);
        times[i] = now() - start;
    }
    qsort(times, (size_t)repeats, sizeof *times, ascending);
    double middle = times[repeats / 2];
    free(times);
    return middle;
}

static Maps maps(void) {
    Maps to = {malloc(PIXELS * 4), malloc(PIXELS * 12), malloc(PIXELS * 8), malloc(PIXELS * 4)};
    if (!to.depth || !to.normal || !to.weights || !to.triangle) stop("no memory for", "the maps");
    return to;
}

int main(int count, char **words) {
    if (count < 6) stop("usage:", "LIBRARY VERTICES TRIANGLES VIEWS REPEATS [coherent]");
    int repeats = atoi(words[5]);
    if (repeats < 1) stop("no number of repeats:", words[5]);
    library = dlopen(words[1], RTLD_NOW);
    if (!library) stop("cannot load", words[1]);
    arguments.flags = count > 6 ? COHERENT : 0;
    intersect1 = call("rtcIntersect1");
    intersect16 = call("rtcIntersect16");

    void *device = ((void *(*)(const char *))call("rtcNewDevice"))("threads=1");
    if (!((intptr_t(*)(void *, int))call("rtcGetDeviceProperty"))(device, NATIVE_16))
        stop("no packets of 16 in", words[1]);
    scene = ((void *(*)(void *))call("rtcNewScene"))(device);
    ((void (*)(void *, int))call("rtcSetSceneFlags"))(scene, ROBUST);
    void *geometry = ((void *(*)(void *, int))call("rtcNewGeometry"))(device, TRIANGLES);
    fill(geometry, VERTICES, FLOAT3, words[2]);
    fill(geometry, INDICES, UINT3, words[3]);
    ((void (*)(void *))call("rtcCommitGeometry"))(geometry);
    ((unsigned (*)(void *, void *))call("rtcAttachGeometry"))(scene, geometry);
    ((void (*)(void *))call("rtcCommitScene"))(scene);

    FILE *views = fopen(words[4], "r");
    if (!views) stop("cannot read", words[4]);
    Maps one = maps(), many = maps();
    View view;
    float *number = (float *)&view;
    for (int read = 0; fscanf(views, "%f", &number[read]) == 1;) {
        if (++read < 12) continue;
        read = 0;
        double single = median(repeats, singles, &view, 0, one);
        double single_all = median(repeats, singles, &view, 1, one);
        double packet = median(repeats, packets, &view, 0, many);
        double packet_all = median(repeats, packets, &view, 1, many);
        long hits = 0, hits_16 = 0, different = 0;
        for (size_t i = 0; i < PIXELS; i++) {
            hits += one.triangle[i] != NOTHING;
            hits_16 += many.triangle[i] != NOTHING;
            different += one.triangle[i] != many.triangle[i];
        }
        printf("%ld %ld %ld %.6f %.6f %.6f %.6f\n", hits, hits_16, different, single, single_all, packet, packet_all);
        fflush(stdout);
    }
    return 0;
}
