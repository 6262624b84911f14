// tactilux-led: the plain line protocol (hw/README.md) on an Arduino Nano, Uno or any other board
// with a serial port, for a chain of WS2812 LEDs. Needs the library Adafruit_NeoPixel.
//
// One request per line, one answer per line. All LEDs go dark when the watchdog is set and no
// line has come for so long: a host that crashed or was unplugged leaves no light behind.

#include <Adafruit_NeoPixel.h>

const uint8_t DATA_PIN = 6;
const uint16_t LEDS = 20;
const char NAME[] = "nano-ws2812";
const uint8_t LONGEST = 64;  // characters of a request; longer lines are dropped
const uint8_t COLORS = 8;    // LEDs in one answer to GET

Adafruit_NeoPixel strip(LEDS, DATA_PIN, NEO_GRB + NEO_KHZ800);
char line[LONGEST + 1];
uint8_t length = 0;
bool tooLong = false;
unsigned long heard = 0;
unsigned long watchdog = 0;  // milliseconds, 0 is asleep

// CRC-8, polynomial 0x07, start 0 (SMBus).
uint8_t crc8(const char *text, uint8_t count) {
  uint8_t crc = 0;
  for (uint8_t i = 0; i < count; i++) {
    crc ^= (uint8_t)text[i];
    for (uint8_t bit = 0; bit < 8; bit++) crc = (crc & 0x80) ? (crc << 1) ^ 0x07 : crc << 1;
  }
  return crc;
}

void answer(const char *body) {
  char sum[8];
  snprintf(sum, sizeof sum, "*%02X\n", crc8(body, strlen(body)));
  Serial.print(body);
  Serial.print(sum);
}

void reply(long number, const char *what) {
  char body[48];
  snprintf(body, sizeof body, "%ld %s", number, what);
  answer(body);
}

void dark() {
  strip.clear();
  strip.show();
}

// Read up to `most` whole numbers; -1 if there is anything else.
int8_t numbers(char *text, long *found, int8_t most) {
  int8_t count = 0;
  for (char *word = strtok(text, " "); word; word = strtok(NULL, " ")) {
    char *end;
    if (count == most) return -1;
    found[count++] = strtol(word, &end, 10);
    if (*end) return -1;
  }
  return count;
}

// The color that an LED shows: the library keeps what was set, and dims it when it sends it.
uint32_t colorOf(uint16_t led) {
  uint32_t set = strip.getPixelColor(led), found = 0;
  for (uint8_t shift = 0; shift < 24; shift += 8)
    found |= ((((set >> shift) & 0xFF) * (strip.getBrightness() + 1)) >> 8) << shift;
  return found;
}

// Answer GET with the colors of the LEDs from `first` on, as many as fit.
void tell(long number, long first) {
  char body[64];
  int length = snprintf(body, sizeof body, "%ld OK ", number);
  for (long led = first; led < LEDS && led < first + COLORS; led++)
    length += snprintf(body + length, sizeof body - length, "%06lX", (unsigned long)colorOf(led));
  answer(body);
}

// Do what the words say; return what is wrong with them, or NULL.
const char *obey(char *words) {
  long n[4];
  char *rest = strchr(words, ' ');
  if (rest) *rest++ = 0;
  int8_t count = rest ? numbers(rest, n, 4) : 0;
  if (count < 0) return "number";
  if (!strcmp(words, "SET") && count == 4) {
    if (n[0] < 0 || n[0] >= LEDS) return "range";
    for (uint8_t i = 1; i < 4; i++)
      if (n[i] < 0 || n[i] > 255) return "range";
    strip.setPixelColor(n[0], n[1], n[2], n[3]);
  } else if (!strcmp(words, "SHOW") && count == 0) {
    strip.show();
  } else if (!strcmp(words, "OFF") && count == 0) {
    dark();
  } else if (!strcmp(words, "WDT") && count == 1) {
    if (n[0] < 0 || n[0] > 60000) return "range";
    watchdog = n[0];
  } else if (strcmp(words, "PING") || count != 0) {
    return "word";
  }
  return NULL;
}

void handle() {
  if (!strcmp(line, "*IDN?")) {
    char body[48];
    snprintf(body, sizeof body, "tactilux-led,2,%s,%u", NAME, LEDS);
    answer(body);
    return;
  }
  char *star = strrchr(line, '*');
  char *end;
  long sum = star && strlen(star) == 3 ? strtol(star + 1, &end, 16) : -1;
  if (!star || sum < 0 || *end || sum != crc8(line, star - line)) {
    reply(atol(line), "ERR checksum");
    return;
  }
  *star = 0;
  char *words = strchr(line, ' ');
  long number = atol(line);
  if (!words) {
    reply(number, "ERR word");
    return;
  }
  long first;
  if (!strncmp(words, " GET ", 5) && numbers(words + 5, &first, 1) == 1) {
    if (first < 0 || first >= LEDS) reply(number, "ERR range");
    else tell(number, first);
    return;
  }
  const char *problem = obey(words + 1);
  if (!problem) {
    reply(number, "OK");
    return;
  }
  char what[16];
  snprintf(what, sizeof what, "ERR %s", problem);
  reply(number, what);
}

void setup() {
  Serial.begin(115200);
  strip.begin();
  dark();
}

void loop() {
  while (Serial.available()) {
    char c = Serial.read();
    if (c == '\r') continue;
    if (c != '\n') {
      if (length < LONGEST) line[length++] = c;
      else tooLong = true;
      continue;
    }
    line[length] = 0;
    heard = millis();
    if (!tooLong && length) handle();
    length = 0;
    tooLong = false;
  }
  if (watchdog && millis() - heard > watchdog) {
    dark();
    heard = millis();
  }
}
