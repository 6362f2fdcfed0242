// What a number is worth with the unit beside it.

import { UNITS } from "../../host/page/src/views/units";

const NEWTONS: Record<string, number> = { N: 1, mN: 1e-3, gf: 9.80665e-3, mgf: 9.80665e-6 };
const NEWTON_METRES: Record<string, number> = { "N mm": 1e-3, "mN m": 1e-3, "gf cm": 9.80665e-5 };

test("every unit is worth what its name says, of a node, too", () => {
  for (const unit of UNITS) {
    expect(unit.perN * NEWTONS[unit.name]!).toBeCloseTo(1, 5);
    expect(unit.nodePerN * NEWTONS[unit.nodeName]!).toBeCloseTo(1, 5);
    expect(unit.perNm * NEWTON_METRES[unit.momentName]!).toBeCloseTo(1, 5);
  }
});
