// The serial console: `provision`, `calibrate` and `correct`, a line each. What comes in is never echoed, so
// the key is not either.
#pragma once

// Listens for good, in a task of its own on Wi-Fi's core. A command that was kept restarts the module.
void provisioning_start(void);
