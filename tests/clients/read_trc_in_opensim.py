"""Read a TRC file in OpenSim and write what is seen there: read_trc_in_opensim.py TRC NPZ."""

import sys

import numpy as np
import opensim

path, out = sys.argv[1:]
table = opensim.TimeSeriesTableVec3(path)
names = table.getColumnLabels()
flat = table.flatten()  # owns what getMatrix() only points to
values = flat.getMatrix().to_numpy()
np.savez(
    out,
    names=list(names),
    positions=values.reshape(len(values), len(names), 3),
    times=np.array(table.getIndependentColumn()),
    rate=float(table.getTableMetaDataAsString("DataRate")),
    units=table.getTableMetaDataAsString("Units"),
)
