"""Physics beyond calibration: one file per effect, each adds its part to an ideal reading.

To add an effect, write one file here with a class derived from `base.Effect`; `catalogue` finds it,
and it can be simulated (twins), diagnosed by name, taken out of a recording and compensated. The
class says:

- `name`, `triads`, `title`, `equation`, `parameters` with unit, largest plausible size and source;
- `add(columns, values)`: what it adds to the ideal reading, the only place of its equation;
- `needs`, `excited_by`, `taken_for`, `separated_by`: what shows it, and what it is mistaken for;
- `in_calibration(values)`: what it is in a calibration, or in `not_live` why it is nothing there;
- where they apply, `alters_motion`, `is_timing` with `delay_s`, `limited_by`, `is_constant`.

`thermal_bias` is a plain example, `low_pass` one with parameters that are searched over. An effect
defined elsewhere is made known by `catalogue.register`.
"""
