# %% [markdown]
# # An archive in pandas
#
# Fit all recordings of a folder, then work with the table. Here are six simulated recordings of
# the paper's experiment. It needs `pip install 'microbot_ros[dask]' pandas`.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from microbot_ros.archive import read_table, run_batch
from microbot_ros.paper.repetition import record
from microbot_ros.session import write_session

with TemporaryDirectory() as place:
    recordings = Path(place) / 'recordings'
    for seed in range(6):
        write_session(recordings / f'day {seed}', record(seed))
    summary, _ = run_batch('fit', [recordings], Path(place) / 'archive', {'exposure_s': 0.0},
                           workers=1)
    table = read_table(Path(place) / 'archive').to_pandas()
print(f'{summary.done} recordings done, {len(table)} rows')

# %% [markdown]
# One row is one particle of one recording. Columns end in their unit; [all
# columns](../../how-to/archive.md).

# %%
columns = ['session', 'particle', 'v_um_s', 'v_um_s_std', 'phi_rad']
print(table[columns].head(6).round(3).to_string())

# %%
print(table.groupby('particle')[['v_um_s', 'phi_rad']].agg(['mean', 'std']).round(3))

# %%
figure, axes = plt.subplots(figsize=(5, 3), layout='constrained')
for particle, rows in table.groupby('particle'):
    axes.errorbar(range(len(rows)), rows['v_um_s'], 1.96 * rows['v_um_s_std'], fmt='o',
                  capsize=3, label=f'particle {particle}')
axes.set(xlabel='recording', ylabel='v ± 95 % (µm/s)')
axes.legend(ncols=3, loc='lower center', bbox_to_anchor=(0.5, 1))
