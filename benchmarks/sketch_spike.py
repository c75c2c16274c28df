"""Spike: hidden effects named from a sketch alone, virtual cells as what is usual (not part of the product)."""
import sys; sys.path.insert(0,'/work/shared/acceptance')
import numpy as np, pandas as pd, importlib.util
from cellwise import CellLog, read_model
from cellwise.estimate.fixed.fixed_step import FixedStep
from cellwise.diagnose.sketch import *
spec=importlib.util.spec_from_file_location('acc','/work/shared/acceptance/accept.py'); acc=importlib.util.module_from_spec(spec); spec.loader.exec_module(acc)
m=read_model('/tmp/s48/pan25.json')
dt=float(sys.argv[2])
f=FixedStep(m,dt_s=dt,sketch=True)
D='/work/shared/data/panasonic_18650pf/drive_p25_%s.csv.gz'
R={n:pd.read_csv(D%n) for n in ['nn','us06','hwfta','hwftb','cycle_4','cycle_2','cycle_3']}
L=lambda d: CellLog(d.time_s.to_numpy(),d.current_A.to_numpy(),d.voltage_V.to_numpy(),temperature_C=d.temperature_C.to_numpy())
S=lambda *ds: SketchSums.of(f.sketch([L(d) for d in ds],1.0,0.02))
from cellwise.benchmark.certify.virtual_cells import draw_cell, CellSpread
from cellwise.cell.protocol import run_protocol
from cellwise.estimate.sensor import Sensor
import time
print([n for n in dir(Sensor) if not n.startswith('_')][:20])
t0=time.process_time()
virt=[]
import cellwise.diagnose.sketch as sk
N=int(sys.argv[4]); H=float(sys.argv[5])
for i in range(N):
    c=draw_cell(m,i,7,H,dt,Sensor(),CellSpread(faded=0.0,resistance_grown=0.0,slipped_soc=0.0))
    lg=run_protocol(c.truth,c.steps,c.soc0,dt,25.0)
    virt.append(SketchSums.of(f.sketch([lg],c.soc0,0.02)))
print('virtual cpu',time.process_time()-t0, np.mean([v.mismatch for v in virt]), np.mean([v.hours for v in virt]))
P=prior_std(m)
def M_of(v):
    th=[]
    for o in v:
        inf=o.information*np.outer(P,P)/o.mismatch; th.append(np.linalg.solve(inf+np.eye(10),o.score*P/o.mismatch))
    return np.cov(np.array(th).T, bias=True)*np.outer(P,P), np.array(th)
M,th=M_of(virt); print('virtual /prior',np.sqrt(np.diag(M))/P)
base=[S(R[k]) for k in (['cycle_2','cycle_3','cycle_4','hwfta','hwftb'] if len(sys.argv)<7 else ['cycle_2','cycle_3'])]
np.set_printoptions(precision=3,suppress=True,linewidth=160)
print('own  /prior', np.sqrt(np.diag(own_error(m)))/prior_std(m)); print('base /prior', np.sqrt(np.diag(own_error(m,base)))/prior_std(m))
rng=np.random.default_rng(int(sys.argv[1]))
sizes={"current_offset":(0.02,0.05),"current_gain":(0.03,0.08),"voltage_offset":(0.010,0.030),"time_skew":(0.4,1.0),"resistance_scale":(0.25,0.6),"hysteresis":(0.015,0.04),"slow_diffusion":(1.0,2.5),"none":(0,0)}
for rep in range(int(sys.argv[3])):
  for kind,(lo,hi) in sizes.items():
    size=rng.uniform(lo,hi)*(rng.choice([-1,1]) if kind in("current_offset","current_gain","voltage_offset") else 1)
    s=S(*[acc.injected(R[x].copy(),kind,size) for x in (('nn','us06') if len(sys.argv)<7 else ('nn','us06','hwfta','hwftb','cycle_4'))])
    for w,b in (('virt',virt),('both',virt+base)):
      Mx=M_of(b)[0] if w=='virt' else M+M_of(base)[0]
      sk.own_error=lambda *a: Mx
      r=diagnose_sketch(m,[s],b)
      print('%-16s %.3f %-5s'%(kind,size,w),r.verdict,[(c.causes[0],round(c.probability,2)) for c in r.causes],[(p.name,round(p.value,4),round(p.std,4)) for p in r.parameters],[('+'.join(c.causes) or '-',round(c.probability,2)) for c in r.competing[:3]],'%.1f'%s.mismatch)
