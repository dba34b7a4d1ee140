#include "node.h"

#include "ticks.h"

#define RETRY_US 1000000             // a radio that does not answer is tried again
#define CALIBRATE_EVERY_US 30000000  // modules warm up within minutes, by a millimetre or two each
#define LEAST_CC (-4000)         // of what modules work in (DS 5.1), hundredths of a degree; a sensor that
#define MOST_CC 8500             // tells anything else is not believed
#define LEAVE_WITHIN_US 1000000  // then it leaves without a word
#define MOST_EVENTS 8            // in one call; the interrupt line calls again

_Static_assert(FRAME_MAX <= DW1000_MAX_FRAME, "each frame fits into the radio");
_Static_assert(FRAME_LAST_ADDRESS == WIRE_LAST_ADDRESS && FRAME_LATEST_NS == WIRE_MAX_TIME_NS,
               "what is said on the air can be told on the network");
_Static_assert(DW1000_UNKNOWN_POWER == WIRE_UNKNOWN_POWER && DW1000_UNKNOWN_CLOCK == WIRE_UNKNOWN_CLOCK,
               "what is not known is passed on as it is");

static uint64_t now(const struct node* node) { return node->hal->now_us(node->hal->board); }

static void enter(struct node* node, enum node_state state) {
  node->state = state;
  node->since_us = now(node);
}

static struct dw1000_settings radio_settings(const struct node* node) {
  const struct node_settings* s = &node->settings;
  return (struct dw1000_settings){
      .channel = s->channel,
      .prf_mhz = s->prf_mhz,
      .pan = (uint16_t)s->session,
      .address = s->address,
      .eui64 = s->eui64,
      .antenna_delay = s->calibration.antenna_delay,
  };
}

static void calibrate(struct node* node) {
  node->calibrated_us = now(node);
  const int16_t temperature_cc = dw1000_temperature_cc(&node->radio);
  if (temperature_cc < LEAST_CC || temperature_cc > MOST_CC) return;
  dw1000_set_antenna_delay(&node->radio,
                           calibration_antenna_delay(&node->settings.calibration, temperature_cc));
}

static void start_radio(struct node* node, bool sleeps) {
  const struct dw1000_settings settings = radio_settings(node);
  const enum dw1000_result result = sleeps ? dw1000_wake(&node->radio, node->hal, &settings)
                                           : dw1000_start(&node->radio, node->hal, &settings);
  if (result != DW1000_OK) {
    enter(node, NODE_SILENT);
    node->wake_us = now(node) + RETRY_US;
    return;
  }
  enter(node, NODE_RANGING);
  calibrate(node);
  const struct ranging_settings ranging = {
      .pan = (uint16_t)node->settings.session,
      .address = node->settings.address,
      .scheme = node->settings.scheme,
      .restarts = node->settings.restarts,
      .epochs = node->ranging.settings.epochs,
  };
  node->ranging_us =
      ranging_start(&node->ranging, &node->radio, &ranging, node->hal->random(node->hal->board));
  node->alive_us = now(node);
}

static void fall_asleep(struct node* node) {
  (void)outbox_send(&node->outbox, node->hal, node->settings.key, now(node), true);
  dw1000_sleep(&node->radio);
  enter(node, NODE_ASLEEP);
  node->wake_us = node->since_us + (uint64_t)node->sleep_s * 1000000;
}

// A board whose radio does not answer sleeps too: it would be empty within a day.
static void leave(struct node* node, uint32_t sleep_s) {
  node->sleep_s = sleep_s;
  if (node->state == NODE_RANGING) {
    enter(node, NODE_LEAVING);
    ranging_leave(&node->ranging);
  } else if (node->state == NODE_SILENT) {
    fall_asleep(node);
  }
}

static int32_t rounded_mm(int32_t um) { return (um + (um < 0 ? -500 : 500)) / 1000; }

static void report(struct node* node, const struct ranging_result* result) {
  const struct node_settings* s = &node->settings;
  const int32_t bias_um = calibration_bias_um(s->channel, s->prf_mhz, result->rx_power_cdbm);
  const struct outbox_range range = {
      .at_us = now(node),
      .epoch = result->epoch,
      .time_ns = result->time_ns,
      .range =
          {
              .peer = result->peer,
              .source = result->overheard ? WIRE_OVERHEARD : WIRE_MODULE,
              .status = WIRE_MEASURED,
              .distance_mm = rounded_mm(result->distance_um - bias_um),
              .sigma_mm = s->calibration.sigma_mm > 0 ? s->calibration.sigma_mm : WIRE_UNKNOWN_SIGMA,
              .sight = (uint8_t)calibration_sight(result->rx_power_cdbm, result->fp_power_cdbm),
              .rx_power_cdbm = result->rx_power_cdbm,
              .fp_power_cdbm = result->fp_power_cdbm,
              .clock_ppb = result->clock_ppb,
          },
  };
  outbox_put(&node->outbox, &range);
}

static void tell_ranging(struct node* node, const struct ranging_event* event) {
  struct ranging_result result;
  bool found;
  node->ranging_us = ranging_on_event(&node->ranging, event, &result, &found);
  if (found) report(node, &result);
}

static void serve_radio(struct node* node) {
  static const enum ranging_event_kind kinds[] = {
      [DW1000_SENT] = RANGING_SENT,
      [DW1000_RECEIVED] = RANGING_RECEIVED,
      [DW1000_TIMED_OUT] = RANGING_LOST,
      [DW1000_BAD_RECEPTION] = RANGING_LOST,
  };
  uint8_t bytes[DW1000_MAX_FRAME];
  for (int i = 0; i < MOST_EVENTS && node->hal->interrupted(node->hal->board); ++i) {
    const struct dw1000_event event = dw1000_service(&node->radio, bytes);
    if (event.kind == DW1000_NOTHING) return;
    if (event.kind == DW1000_SENT || event.kind == DW1000_RECEIVED) node->alive_us = now(node);
    const struct ranging_event told = {
        .kind = kinds[event.kind],
        .stamp = event.stamp,
        .bytes = bytes,
        .size = event.size,
        .rx_power_cdbm = event.rx_power_cdbm,
        .fp_power_cdbm = event.fp_power_cdbm,
        .clock_ppb = event.clock_ppb,
    };
    tell_ranging(node, &told);
  }
}

static bool ranged_enough(const struct node* node) {
  const struct node_settings* s = &node->settings;
  return s->range_s > 0 && s->sleep_s > 0 && now(node) - node->began_us >= (uint64_t)s->range_s * 1000000;
}

static void look_after_state(struct node* node) {
  const uint64_t now_us = now(node);
  switch (node->state) {
    case NODE_SILENT:
      if (ranged_enough(node)) {
        leave(node, node->settings.sleep_s);
      } else if (now_us >= node->wake_us) {
        start_radio(node, false);
      }
      break;
    case NODE_RANGING:
      if (ranged_enough(node)) {
        leave(node, node->settings.sleep_s);
      } else if (now_us - node->alive_us >= RANGING_NEVER_SILENT_US) {
        start_radio(node, false);
      } else if (now_us - node->calibrated_us >= CALIBRATE_EVERY_US &&
                 node->ranging.waiting == WAITING_NOTHING) {
        calibrate(node);
      }
      break;
    case NODE_LEAVING:
      if (node->ranging.state == RANGING_LEFT || now_us - node->since_us >= LEAVE_WITHIN_US)
        fall_asleep(node);
      break;
    case NODE_ASLEEP:
      break;
  }
}

static uint64_t state_deadline(const struct node* node) {
  switch (node->state) {
    case NODE_RANGING:
      return earlier_of(node->ranging_us, node->alive_us + RANGING_NEVER_SILENT_US);
    case NODE_LEAVING:
      if (node->ranging.state == RANGING_LEFT) return 0;
      return earlier_of(node->ranging_us, node->since_us + LEAVE_WITHIN_US);
    case NODE_SILENT:
    case NODE_ASLEEP:
      break;
  }
  return node->wake_us;
}

static uint64_t go_on(struct node* node) {
  look_after_state(node);
  if (node->state == NODE_ASLEEP) return node->wake_us;
  const uint64_t outbox_us = outbox_send(&node->outbox, node->hal, node->settings.key, now(node), false);
  if (node->state == NODE_RANGING) {
    outbox_greet(&node->outbox, node->hal, node->settings.key, now(node), node->ranging.epoch,
                 node->ranging.epoch_ns);
  }
  return earlier_of(state_deadline(node), outbox_us);
}

uint64_t node_start(struct node* node, const struct hal* hal, const struct node_settings* settings,
                    bool radio_sleeps) {
  *node = (struct node){.hal = hal, .settings = *settings};
  node->began_us = now(node);
  outbox_start(&node->outbox, settings->session, settings->address, settings->restarts);
  start_radio(node, radio_sleeps);
  return go_on(node);
}

uint64_t node_run(struct node* node) {
  if (node->state == NODE_RANGING || node->state == NODE_LEAVING) {
    serve_radio(node);
    if (now(node) >= node->ranging_us) tell_ranging(node, &(struct ranging_event){.kind = RANGING_DEADLINE});
  }
  return go_on(node);
}

// An order answers a datagram of this start of ours: an old one that is played again cannot put us to sleep.
static bool is_for_us(struct node* node, const struct wire_order* order) {
  return order->session == node->settings.session && order->module == node->settings.address &&
         order->sequence >> 32 == node->settings.restarts && order->sequence < node->outbox.sequence &&
         wire_window_take(&node->orders, order->sequence);
}

uint64_t node_hear(struct node* node, const uint8_t* datagram, size_t size) {
  struct wire_order order;
  if (wire_read_order(datagram, size, node->settings.key, &order) && is_for_us(node, &order)) {
    if (order.sleep_s > 0) {
      leave(node, order.sleep_s);
    } else {
      node->began_us = now(node);
    }
  }
  return go_on(node);
}
