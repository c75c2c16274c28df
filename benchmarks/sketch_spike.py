"""Spike: hidden effects named from a sketch alone (not part of the product)."""
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
base=[S(R[k]) for k in (['cycle_2','cycle_3','cycle_4','hwfta','hwftb'] if len(sys.argv)<5 else ['cycle_2','cycle_3'])]
np.set_printoptions(precision=3,suppress=True,linewidth=160)
print('own  /prior', np.sqrt(np.diag(own_error(m)))/prior_std(m)); print('base /prior', np.sqrt(np.diag(own_error(m,base)))/prior_std(m))
rng=np.random.default_rng(int(sys.argv[1]))
sizes={"current_offset":(0.02,0.05),"current_gain":(0.03,0.08),"voltage_offset":(0.010,0.030),"time_skew":(0.4,1.0),"resistance_scale":(0.25,0.6),"hysteresis":(0.015,0.04),"slow_diffusion":(1.0,2.5),"none":(0,0)}
for rep in range(int(sys.argv[3])):
  for kind,(lo,hi) in sizes.items():
    size=rng.uniform(lo,hi)*(rng.choice([-1,1]) if kind in("current_offset","current_gain","voltage_offset") else 1)
    s=S(*[acc.injected(R[x].copy(),kind,size) for x in (('nn','us06') if len(sys.argv)<5 else ('nn','us06','hwfta','hwftb','cycle_4'))])
    for w,b in (('own',()),('base',base)):
      r=diagnose_sketch(m,[s],b)
      print('%-16s %.3f %-5s'%(kind,size,w),r.verdict,[(c.causes[0],round(c.probability,2)) for c in r.causes],[(p.name,round(p.value,4),round(p.std,4)) for p in r.parameters],[('+'.join(c.causes) or '-',round(c.probability,2)) for c in r.competing[:3]],'%.1f'%s.mismatch)
s=S(*[acc.injected(R[x].copy(),'resistance_scale',0.5) for x in ('nn','us06')])
u=prior_std(m); print('hours',s.hours, s.charge_Ah, 'score',s.score*u, '\ninfo diag',np.diag(s.information)*u*u)
P=__import__('cellwise.diagnose.sketch',fromlist=['x'])._Problem(s.score*u/s.mismatch,s.information*np.outer(u,u)/s.mismatch,own_error(m,base)/np.outer(u,u))
print(P.theta, np.sqrt(np.diag(np.linalg.inv(P.inverse)))); print('best', max(P._sets(), key=lambda a:P._gain(a)-6.9*len(a)), P._gain((OHMIC,)))
