"""A recurrent network as papers train it: a GRU from current, voltage and temperature to the SOC.

After Yang et al. (2019), doi:10.1016/j.energy.2019.03.176: one layer of 32 units and a linear
output, Adam, windows of the training logs on a step of 10 s, currents and voltages blurred as
Chemali et al. (2018) do for sensors that are off. The last drive of the cell's tests is held back:
the weights that are best on it are kept, and its error is the band. Knows nothing of its start.
"""

import math

import numpy as np
import torch
from serve import at_period

PERIOD_S, WINDOW, BATCH, UNITS, STEPS, CHECK = 10.0, 180, 12, 32, 240, 20
RATE, CURRENT_OFF, VOLTAGE_OFF = 1e-2, 0.02, 0.01  # of 1C; V, standard deviations
torch.set_num_threads(1)


class Net(torch.nn.Module):
    """GRU and linear output."""

    def __init__(self):
        super().__init__()
        self.gru = torch.nn.GRU(3, UNITS, batch_first=True)
        self.out = torch.nn.Linear(UNITS, 1)

    def forward(self, x, h=None):
        y, h = self.gru(x, h)
        return self.out(y)[..., 0], h


def features(cell, current_A, voltage_V, temperature_C):
    """Scaled inputs, last axis (current, voltage, temperature)."""
    low, high = cell.tables["ocv_V"].min(), cell.tables["ocv_V"].max()
    parts = (current_A / cell.capacity_Ah, (voltage_V - low) / (high - low), temperature_C / 50.0)
    return np.stack(np.broadcast_arrays(*parts), axis=-1).astype(np.float32)


class Row:
    """The trained network, a sample at a time."""

    state_bytes = 4 * UNITS

    def __init__(self, cell, fitted):
        self.cell, self.net = cell, Net()
        self.net.load_state_dict({k: torch.tensor(v) for k, v in fitted["weights"].items()})
        self.std = fitted["rmse"]

    @staticmethod
    def fit(cell, seed):
        """Train on the cell's tests but the last drive, which says when to stop."""
        torch.manual_seed(seed)
        rng = np.random.default_rng(seed)
        logs = [at_period(log, PERIOD_S) for _, log in cell.logs]
        sets = [
            (features(cell, g["current_A"], g["voltage_V"], g["temperature_C"]), g["soc"])
            for g in logs
            if g["time_s"].size > WINDOW
        ]
        (held_x, held_y), train = sets[-1], sets[:-1]
        shares = np.array([min(y.size, 2000) for _, y in train], dtype=float)
        net, best = Net(), (math.inf, None)
        how = torch.optim.Adam(net.parameters(), lr=RATE)
        plan = torch.optim.lr_scheduler.CosineAnnealingLR(how, STEPS)
        unit_V = 1.0 / (cell.tables["ocv_V"].max() - cell.tables["ocv_V"].min())
        for step in range(STEPS):
            x, y = [], []
            for k in rng.choice(len(train), BATCH, p=shares / shares.sum()):
                first = int(rng.integers(0, train[k][1].size - WINDOW + 1))
                off = rng.normal(size=2) * (CURRENT_OFF, VOLTAGE_OFF * unit_V)
                x.append(train[k][0][first : first + WINDOW] + np.array([*off, 0.0], np.float32))
                y.append(train[k][1][first : first + WINDOW])
            told, _ = net(torch.tensor(np.array(x, np.float32)))
            wrong = (told - torch.tensor(np.array(y, np.float32)))[:, 10:]
            how.zero_grad()
            (wrong**2).mean().backward()
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            how.step()
            plan.step()
            if step % CHECK == CHECK - 1:
                with torch.inference_mode():
                    told, _ = net(torch.tensor(held_x[None]))
                rmse = float(np.sqrt(np.mean((told[0].numpy()[10:] - held_y[10:]) ** 2)))
                if rmse < best[0]:
                    best = rmse, {k: v.numpy().copy() for k, v in net.state_dict().items()}
        return {"rmse": best[0], "weights": best[1]}

    def start(self, soc0, soc0_std):
        self.hidden, self.soc, self.last_V = None, soc0, math.nan

    def step(self, current_A, voltage_V, temperature_C, dt_s):
        self.last_V = voltage_V if voltage_V == voltage_V else self.last_V
        if self.last_V == self.last_V:
            x = features(self.cell, current_A, self.last_V, temperature_C)
            with torch.inference_mode():
                told, self.hidden = self.net(torch.tensor(x[None, None]), self.hidden)
            self.soc = min(max(float(told), 0.0), 1.0)
        return self.soc, self.std, math.nan
