"""Identify a cell from its laboratory tests, and see what the model is worth."""

import cellwise as cw

tests = cw.CellTests(
    hppc=cw.load_dataset("nmc_hppc"),
    ocv=cw.load_dataset("nmc_ocv_c20"),
    capacity=(cw.load_dataset("nmc_cap_c3"),),
)
found = cw.identify_cell(tests, cw.IdentifySettings(nominal_Ah=5.0, name="LG M50", refine=False))
print(found)
print("pulses:", found.pulse_counts)
for notice in found.notices:
    print("!", notice)

# On a drive that took no part in it.
print(cw.simulate(found.model, cw.load_dataset("nmc_drive_b"), soc0=1.0))
found.model.plot().savefig("model.svg")
cw.write_model(found.model, "m50.json")
