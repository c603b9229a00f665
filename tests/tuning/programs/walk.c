/* A Kalman filter for a scalar that walks at random and is measured: walk PARAMETERS LOG OUT [FAULT].
   PARAMETERS holds lines name = value: walk_noise (per root second) and meter_noise. FAULT is what it does
   wrong. */
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static int is(const char *fault, const char *name) { return !strcmp(fault, name); }

int main(int argc, char **argv) {
  double q = 1.0, r = 1.0, value, time, z, x = 0.0, P = 100.0, before = 0.0;
  char line[256], name[128];
  FILE *in, *out;
  int first = 1, rows = 0;
  const char *fault = argc == 5 ? argv[4] : "";
  if (argc != 4 && argc != 5) { fprintf(stderr, "usage: walk PARAMETERS LOG OUT [FAULT]\n"); return 2; }
  in = fopen(argv[1], "r");
  if (!in) { fprintf(stderr, "no parameters at %s\n", argv[1]); return 2; }
  while (fgets(line, sizeof line, in))
    if (sscanf(line, "%127s = %lf", name, &value) == 2) {
      if (!strcmp(name, "walk_noise")) q = value * value;
      if (!strcmp(name, "meter_noise")) r = value * value;
    }
  fclose(in);
  if (is(fault, "fails") && q > 64.0) { fprintf(stderr, "the filter lost its track\n"); return 1; }
  if (is(fault, "fails") && q < 0.0025) sleep(60);
  if (is(fault, "ignores")) r = 4.0;
  if (is(fault, "chance")) {
    FILE *dice = fopen("/dev/urandom", "r");
    q *= 1.0 + fgetc(dice) / 256.0;
    fclose(dice);
  }
  if (is(fault, "damaged") && strstr(argv[2], "1.csv")) { fprintf(stderr, "damaged\n"); return 1; }
  in = fopen(argv[2], "r");
  if (!in) { fprintf(stderr, "no log at %s\n", argv[2]); return 2; }
  out = fopen(argv[3], "w");
  fprintf(out, "time,innovation,variance\n");
  if (is(fault, "fails") && r > 100.0) { fprintf(out, "what?\never\n"); return 0; }
  while (fgets(line, sizeof line, in)) {
    if (sscanf(line, "%lf,%lf", &time, &z) != 2) continue;
    if (is(fault, "drops") && q < 1.0 && ++rows > 200) break;
    if (!first) P += q * (time - before);
    double s = P + r, nu = z - x, k = P / s;
    fprintf(out, "%.9g,%.12g,%.12g\n", time, nu, s);
    x += k * nu;
    P *= 1.0 - k;
    before = time;
    first = 0;
  }
  fclose(in);
  return fclose(out) != 0;
}
