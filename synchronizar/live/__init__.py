"""The live side: ranges as they come from modules and phones."""
