"""Spike of issue 48: an open-loop sketch against a baseline, pictures of the own logs, on eight cells.

sketch_spike.py sums CELL | sketch_spike.py name CELL,CELL DRIVES [(ridge,1.,6.9,.2)] own|emp
"""
import numpy as np, pandas as pd, pickle, time
from cellwise import CellLog, read_model
from cellwise.cell.initial_soc.initial_soc import InitialSoc
from cellwise.diagnose.causes.coordinates import Coordinates
from cellwise.diagnose.fit.rows import gather
from cellwise.logs.cell_log import resample
import os, sys; D=os.environ['CELLWISE_DATA']+'/'; HERE=os.environ['SPIKE']+'/'  # models CELL.json, sums written there; P=D+'panasonic_18650pf/'
P=D+'panasonic_18650pf/'; Q_AH=2.9973
def injected(d, kind, size, Q=Q_AH, R=0.028):
    d=d.copy(); i,dt=d.current_A.to_numpy(),np.diff(d.time_s.to_numpy(),prepend=d.time_s.iloc[0])
    def fo(tau,drive):
        x=np.zeros(len(i)); a=np.exp(-dt/tau)
        for k in range(1,len(i)): x[k]=a[k]*x[k-1]+(1-a[k])*drive[k]
        return x
    if kind=='current_offset': d['current_A']=d.current_A+size*Q
    elif kind=='current_gain': d['current_A']=d.current_A*(1+size)
    elif kind=='voltage_offset': d['voltage_V']+=size
    elif kind=='time_skew': d['voltage_V']=np.interp(d.time_s-size,d.time_s,d.voltage_V)
    elif kind=='resistance_scale': d['voltage_V']-=size*R*d.current_A
    elif kind=='slow_diffusion': d['voltage_V']-=size*R*fo(1500.0,i)
    elif kind=='hysteresis':
        with np.errstate(divide='ignore'): d['voltage_V']+=size*fo(3600.0*Q/(60.0*np.maximum(abs(i),1e-9)),-np.sign(i))
    return d
SIZES={"current_offset":(0.02,0.05),"current_gain":(0.03,0.08),"voltage_offset":(0.010,0.030),"time_skew":(0.4,1.0),"resistance_scale":(0.25,0.6),"hysteresis":(0.015,0.04),"slow_diffusion":(1.0,2.5),"none":(0,0)}

def L(d,s0):
    b=float(__import__('os').environ.get('BLOCK','0'))
    if b:
        k=np.floor((d.time_s.to_numpy()-d.time_s.iloc[0])/b); d=d.groupby(k).mean(numeric_only=True); d['time_s']=(d.index.to_numpy()+1)*b
    return L0(d,s0)
def L0(d,s0): return CellLog(d.time_s.to_numpy(),d.current_A.to_numpy(),d.voltage_V.to_numpy(),temperature_C=(d.temperature_C.to_numpy() if 'temperature_C' in d else None),soc0=s0)
EFF={'current_offset':[('offset_A','c',0.03)],'current_gain':[('ln_gain','1',0.05)],'voltage_offset':[('offset_V','1',0.02)],'time_skew':[('skew_s','1',0.5)],
 'ohmic_resistance':[('added_r0','1',0.3)],'resistance_scale':[('ln_scale','1',0.3)],'slow_diffusion':[('r3','1',1.0)],'hysteresis':[('m_V','1',0.03)],'capacity':[('ln_capacity','1',-0.05)],'soc0':[('soc0:0','1',-0.02)]}
KEYS=list(EFF)
def load_frames(cell):
    if cell=='pan25': own=['p25_cycle_2','p25_cycle_3']; held=['p25_nn','p25_us06','p25_hwfta','p25_hwftb','p25_cycle_4']
    elif cell.startswith('pan_'):
        t=cell[4:]; own=[f'{t}_cycle_2',f'{t}_cycle_3']; held=[f'{t}_nn',f'{t}_us06',f'{t}_hwfet',f'{t}_la92',f'{t}_cycle_1',f'{t}_cycle_4']
    fr={}
    if cell.startswith('pan'):
        for n in own+held:
            d=pd.read_csv(P+f'drive_{n}.csv.gz'); fr[n]=(d[['time_s','current_A','voltage_V','temperature_C']],1.0)
    elif cell=='lg':
        own=['mixed4_p40_562','mixed5_p40_562']; held=['mixed6_p40_562','mixed7_p40_562','mixed8_p40_562']
        for n in own+held:
            d=pd.read_csv(D+f'lg_18650hg2/drive_{n}.csv.gz'); fr[n]=(d,1.0)
    elif cell=='nmc':
        own=['id']; held=['val','dc']
        for n,f,s in (('id','identification',.98268),('val','validation',.97973),('dc','drive_cycle',.952)): fr[n]=(pd.read_csv(D+f'pybatteryid_nmc/nmc_{f}.csv.gz'),s)
    elif cell=='lfp':
        own=['p25','p05']; held=['p35','p45','n15']
        for n in own+held:
            d=pd.read_csv(D+f'plett_a123/dyn_{n}_s1.csv.gz'); d['temperature_C']=float(n.replace('p','').replace('n','-')); fr[n]=(d,1.0)
    return own,held,fr
def cov_full(err,t,soc,drop=None):
    C=np.eye(len(t))*(2e-3)**2
    for k,ts in enumerate(err.scales_s):
        row=np.ravel(np.asarray(err.std_V[k])[-1]); sd=np.interp(soc,np.linspace(0,1,len(row)),row) if len(row)>1 else np.full(len(t),row[0])
        E=np.exp(-np.abs(t[:,None]-t[None])/max(ts,1e-3))
        C+=np.outer(sd,sd)*E
        if drop is not None: C+=err.share[k]**2*np.outer(drop,drop)*E
    return C

def cov(err,t,soc,drop=None):
    """White, and one slow process: what a scalar Kalman filter whitens."""
    mode=__import__('os').environ.get('COVM','full')
    if mode=='full': return cov_full(err,t,soc,drop)
    n=len(t); V=np.full(n,4e-6); S=np.zeros(n); tau=float(mode)
    for k,ts in enumerate(err.scales_s):
        row=np.ravel(np.asarray(err.std_V[k])[-1]); sd=np.interp(soc,np.linspace(0,1,len(row)),row) if len(row)>1 else np.full(n,row[0])
        v=sd**2+err.share[k]**2*drop**2
        if ts<30: V+=v
        else: S+=v
    s=np.sqrt(S); return np.diag(V)+np.outer(s,s)*np.exp(-np.abs(t[:,None]-t[None])/tau)

PART=sys.argv.pop(1)
if PART=='sums':
    cell=sys.argv[1]; m=read_model(HERE+f'{cell}.json'); co=Coordinates(m)
    own,held,fr=load_frames(cell); Q=m.capacity_Ah; R=float(np.median(m.r0_ohm))
    rng=np.random.default_rng(3)
    inj=[('none',0.0)]
    for kind,(lo,hi) in SIZES.items():
        if kind=='none': continue
        for rep in range(2): inj.append((kind,rng.uniform(lo,hi)*(rng.choice([-1,1]) if kind in("current_offset","current_gain","voltage_offset") else 1)))
    U={k:v[0][2]*(Q if v[0][1]=='c' else 1) for k,v in EFF.items()}
    out={'own':own,'held':held,'sums':{},'keys':KEYS,'unit':U}
    t0=time.time(); ocv=np.ravel(m.ocv_V[-1]) if np.ndim(m.ocv_V)>1 else m.ocv_V; floor=float(np.interp(0.2,m.soc,ocv))-0.15*(1 if cell!='lfp' else 2)
    print(m.error.scales_s,m.error.share,[np.round(np.mean(s),4) for s in m.error.std_V])
    for n in own+held:
        d,s0=fr[n]
        base=None
        for kind,size in inj:
            log=resample(L(injected(d,kind,size,Q,0.028 if cell.startswith('pan') else R),s0),float(os.environ.get('BLOCK','1')))
            rows=gather(m,[(log,InitialSoc(s0,0.0,'given'))])
            v0,soc=rows.simulate(co,{})
            if kind=='none': g=np.array([(rows.simulate(co,{EFF[k][0][0]:U[k]})[0]-v0) for k in KEYS]).T
            meas=np.concatenate([l.voltage_V for l in rows.logs]); 
            t=np.concatenate([l.clock_s if l.clock_s.size==v0.size else l.log.time_s[::l.stride] for l in rows.logs])
            st=max(1,int(round(15/np.median(np.diff(t)))),len(t)//800)
            ok=np.arange(0,v0.size,st); ok=ok[(soc[ok]>0.2)&np.isfinite(meas[ok])&(v0[ok]>floor)&(meas[ok]>floor)]; drop=np.interp(soc,m.soc,m.ocv_V[-1] if np.ndim(m.ocv_V)>1 else m.ocv_V)-v0
            if base is None or not np.array_equal(ok,base[0]):
                base=(ok,np.linalg.cholesky(cov(m.error,t[ok],soc[ok],drop[ok])))
            Wg=np.linalg.solve(base[1],g[ok]); Wr=np.linalg.solve(base[1],(meas-v0)[ok])
            out['sums'][n,kind,size]=(Wg.T@Wg,Wg.T@Wr,float(Wr@Wr)/len(ok),float((t[-1]-t[0])/3600))
        print(n,len(ok),time.time()-t0,out['sums'][n,'none',0.0][2],flush=True)
    pickle.dump(out,open(HERE+'ol_'+__import__('os').environ.get('TAG','')+cell+'.pkl','wb'))
else:
    cellsarg=sys.argv[1]; size=int(sys.argv[2]); SETS=eval(sys.argv[3]); MODE=sys.argv[4]; 
    sys.argv=['x',cellsarg]
    cells=sys.argv[1].split(','); O={c:pickle.load(open(HERE+f'ol_{c}.pkl','rb')) for c in cells}
    K=len(KEYS); USEPOP=len(sys.argv)<6; MF=float(sys.argv[4]) if len(sys.argv)>4 else 1.0; RIDGE=float(sys.argv[2]) if len(sys.argv)>2 else 0.25; SPREAD=float(sys.argv[3]) if len(sys.argv)>3 else 0.2
    def pooled(o,key,names):
        A=h=0; 
        for n in names:
            a,b,mm,T=o['sums'][n,*key]; A=A+a/max(mm,1); h=h+b/max(mm,1)
        return A/len(names),h/len(names)
    def st(o,key,names):
        A,h=pooled(o,key,names); B=np.linalg.inv(A+RIDGE*np.eye(K)); return B@h,B@A
    def devs(o):
        m=st(o,('none',0.),o['own'])[0]
        return np.array([st(o,('none',0.),[n])[0]-m for n in o['held']])
    def loo(o):
        a,b=o['own'][0],o['own'][-1]; d=st(o,('none',0.),[a])[0]-st(o,('none',0.),[b])[0]; return [d/np.sqrt(2)] if a!=b else []
    def lnN(x,C): s,ld=np.linalg.slogdet(C); return -0.5*(x@np.linalg.solve(C,x)+ld)
    RIGHT=lambda k:{k}|({'ohmic_resistance','resistance_scale'} if k=='resistance_scale' else set())
    def classify(x,F,M,prior=np.log(200.),wide=9.,unk=np.log(20.)):
        res={'none':lnN(x,M),'unknown':lnN(x,wide*M)-unk}
        for k,f in F.items():
            for tau in (1.0,2.0):
              C=tau**2*(np.outer(f,f)+SPREAD**2*np.eye(K)*(f@f))
              v=np.logaddexp(lnN(x,M+C),lnN(x,wide*M+C)-unk)-prior-np.log(2); res[k]=np.logaddexp(res.get(k,-np.inf),v)
        ks=list(res); p=np.array([res[k] for k in ks]); p=np.exp(p-p.max()); p/=p.sum(); return sorted(zip(ks,p),key=lambda q:-q[1])
    from itertools import combinations
    K=len(next(iter(O[cells[0]]['sums'].values()))[1]); INF=K==10 and cellsarg.startswith('in')
    NAMES=(['current_offset','current_gain','voltage_offset','time_skew','ohmic_resistance','resistance_scale','slow_scale','slow_diffusion','hysteresis','capacity'] if INF else KEYS)
    def combos(o): return list(combinations(o['held'],min(size,max(1,len(o['held'])-1))))
    def basef(o,g): return [n for n in o['own']+o['held'] if n not in g]
    def pairs(o): return np.array([st(o,('none',0.),g)[0]-st(o,('none',0.),basef(o,g))[0] for g in combos(o)])
    def lnN(x,C): s,ld=np.linalg.slogdet(C); return -0.5*(x@np.linalg.solve(C,x)+ld)
    def classify2(x,F,M,prior,wide,unk,spread):
        K=len(x)
        res={'none':lnN(x,M),'unknown':lnN(x,wide*M)-unk}
        for k,f in F.items():
            for tau in (0.7,1.5):
              C=tau**2*(np.outer(f,f)+spread**2*np.eye(K)*(f@f))
              v=np.logaddexp(lnN(x,M+C),lnN(x,wide*M+C)-unk)-prior-np.log(2); res[k]=np.logaddexp(res.get(k,-np.inf),v)
        ks=list(res); p=np.array([res[k] for k in ks]); p=np.exp(p-p.max()); p/=p.sum(); return sorted(zip(ks,p),key=lambda q:-q[1])
    for RIDGE,MF,unk,SP in SETS:
        cnt={t:[0,0,0] for t in (.6,.7,.8,.9)}; n=nc=0; first=0; per={}
        for c in cells:
          o=O[c]; X0=[pairs(O[d]) for d in cells if d!=c]; X0=sum(x.T@x/len(x) for x in X0)/len(X0)
          cc={t:[0,0,0] for t in cnt}; ncl=0;nn=0
          for g in combos(o):
            base=basef(o,g)
            s1=np.array([st(o,('none',0.),[x])[0] for x in base]); s1=(s1-s1.mean(0))*np.sqrt(len(base)/(len(base)-1))*np.sqrt(1/len(g)+1/len(base))
            W=s1.T@s1/len(s1); M=MF*(0.5*X0+0.5*W+0.05**2*np.eye(K))
            m=st(o,('none',0.),base)[0]; FP={}
            if MODE in("emp","own"):
                for (k,s) in sorted({(k,s) for (_,k,s) in o['sums'] if k!='none'}): FP[k]=((st(o,(k,s),base)[0]-m) if MODE=="emp" else (st(o,(k,s),o["own"])[0]-st(o,("none",0.),o["own"])[0]))*(0.5*sum(SIZES[k])/s)
            for key in sorted({(k,s) for (_,k,s) in o['sums']}):
                x,B=st(o,key,g)
                if MODE=='lin':
                    FP={}
                    for i,nme in enumerate(NAMES):
                        if nme not in('soc0','slow_scale','ohmic_resistance'): FP[nme]=B[:,i].copy()
                r=classify2(x-m,FP,M,np.log(20.),9.,unk,SP); top,p=r[0]
                right=RIGHT(key[0])
                if key[0]=='none': nc+=1; ncl+=1
                else: n+=1; nn+=1; first+=top in right; per.setdefault(key[0],[]).append(top if p>=.7 else '('+top[:10]+')')
                for t in cnt:
                    nm=top if p>=t and top not in('none','unknown') else None
                    if nm:
                        j=0 if nm in right else (2 if key[0]=='none' else 1); cnt[t][j]+=1; cc[t][j]+=1
          print('  ',c,nn,ncl,{t:tuple(v) for t,v in cc.items()})
        print(RIDGE,MF,round(float(unk),1),SP,'n',n,nc,'first',first,{t:tuple(v) for t,v in cnt.items()},flush=True)
        if len(SETS)==1:
            for k,v in per.items(): print('   ',k,{a:v.count(a) for a in set(v)})
