// Runs the sketch: main <descriptor of the port> <file of what the LEDs show>.
#include "tactilux_led.ino"

int main(int, char **arguments) {
  port = atoi(arguments[1]);
  shown = arguments[2];
  setup();
  for (;;) loop();
}
