/** What stands in the room besides looks, see game.py. */

export const SCAN = "eyes scan";
export const MARK = "eyes mark";
export const FLOOR = "eyes floor";
