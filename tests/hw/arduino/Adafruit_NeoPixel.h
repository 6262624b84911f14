// As much of Arduino and of Adafruit_NeoPixel as the sketch uses, on a pseudo-terminal.
// What the LEDs show is appended to a file, one line of numbers per show().
#pragma once
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <poll.h>
#include <unistd.h>

inline int port = -1;
inline const char *shown = nullptr;
enum { NEO_GRB = 1, NEO_KHZ800 = 2 };

inline unsigned long millis() {
  using namespace std::chrono;
  return duration_cast<milliseconds>(steady_clock::now().time_since_epoch()).count();
}

struct SerialPort {
  void begin(long) {}
  int available() {
    pollfd one{port, POLLIN, 0};
    return poll(&one, 1, 1) > 0 && (one.revents & POLLIN);
  }
  int read() {
    unsigned char c = 0;
    if (::read(port, &c, 1) != 1) exit(0);
    return c;
  }
  void print(const char *text) {
    if (::write(port, text, strlen(text)) < 0) exit(1);
  }
};
inline SerialPort Serial;

struct Adafruit_NeoPixel {
  int count;
  unsigned char colour[512][3] = {};
  // A sketch whose setup dims its LEDs, as setBrightness does.
  int brightness = getenv("BRIGHTNESS") ? atoi(getenv("BRIGHTNESS")) : 255;
  Adafruit_NeoPixel(int leds, int, int) : count(leds) {}
  void begin() {}
  void clear() { memset(colour, 0, sizeof colour); }
  void setPixelColor(int led, int r, int g, int b) {
    colour[led][0] = r, colour[led][1] = g, colour[led][2] = b;
  }
  uint32_t getPixelColor(int led) {
    return (uint32_t)colour[led][0] << 16 | (uint32_t)colour[led][1] << 8 | colour[led][2];
  }
  uint8_t getBrightness() { return brightness; }
  void show() {
    FILE *file = fopen(shown, "a");
    for (int led = 0; led < count; led++)
      for (int level : colour[led]) fprintf(file, "%d ", level * (brightness + 1) >> 8);
    fprintf(file, "\n");
    fclose(file);
  }
};
