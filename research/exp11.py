import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from twinct.recon.ray_weights import RayWeights,error_of_model,some_views
from twinct.recon.air import noise_in_air
from twinct.recon.levels import Level
from twinct.recon.order import spread_order
from twinct.recon.working import WorkingVolume
from twinct.recon.denoise import lower_variation
from twinct.recon.strength import _misfit
def sweep(level,work,order,shares,lam,floor=0.0,steps=8,per_pass=5):
    A=level.A; since=0.0; between=max(1e-9,float(np.sum(shares[:len(A)]))/per_pass)
    for i,(view,share) in enumerate(zip(order,shares)):
        level.update(work,int(view),float(share),floor,False); since+=share
        if lam and (since>=between or i+1==len(order)):
            x=work.array; lower_variation(x,A.grid,A.kernels,since*lam,floor,steps=steps); A.blocks.clear(x); work=WorkingVolume(A.kernels,x); since=0.0
    return work
def lam_formula(level,m2,noise,kappa=3.5):
    A=level.A; g=A.geometry; depth=g.depth(A.grid.world_from_grid.position); q=np.sqrt(g.panel.pitch_u*g.panel.pitch_v)*float(np.mean(depth/g.sdd))
    vs=[];ls=[]
    for v in some_views(len(A)):
        p=level.p[v]; sees=p>0.02*np.percentile(p,99.9); L=A[v].chords()[0]
        n=0 if noise is None else np.exp(np.clip(p,0,8))*noise.in_air[v]**2
        vs.append(np.mean((n+0*p)[sees])); ls.append(L[L>0].mean())
    nv=float(np.mean(vs)); 
    c=q/(np.sqrt(len(A))*np.mean(ls))
    return c*np.sqrt(nv), c*np.sqrt(kappa*m2)
def run(A,p,photons,passes=2,coarse=2,levels=3,relax=1.5,cb=None,ev=.3,tp=1,split=True,kn=1.0,times=None,trelax=None,flat=False):
    known=None if photons is None else np.full(len(A),float(photons))
    noise=noise_in_air(p,None,known); times={} if times is None else times
    before=None; rho=1.0; T=time.perf_counter()
    for factor in [2**n for n in reversed(range(levels))]:
        if min(*A.domain_shape,*A.range_shape[1:])//factor<8 and factor>1: continue
        level=Level.of(A,p,None,factor,0.0,before); work=WorkingVolume(A.kernels,level.start())
        k=passes if factor==1 else max(1,round(coarse*factor/2)); n=k*len(A)
        lastr=relax*min(1.0,float(np.mean(level.A.domain_shape))/len(A))
        shares=np.geomspace(relax,lastr,n); order=np.resize(spread_order(len(A)),n)
        nl=None if noise is None else type(noise)(noise.in_air/factor,noise.source)
        if factor>1:
            work=sweep(level,work,order,shares,0.0)
            if factor==2:
                times["coarse"]=time.perf_counter()-T; T=time.perf_counter()
                m2=error_of_model(level.A,work.array); ln,lm=lam_formula(level,m2,nl)
                out=sorted(subsets_of(A.geometry,10)[0]); used=sorted(set(range(len(A)))-set(out))
                part,judge=level.of_views(used),level.of_views(out); w=RayWeights.of(nl,len(A),m2).of_views(out)
                wk=WorkingVolume(A.kernels,work.array.copy()); mis=[]; pw=[]
                o=np.resize(spread_order(len(used)),tp*len(used))
                for e in range(-4,5):
                    lam=np.hypot(kn*ln,lm*2.0**e) if split else np.hypot(kn*ln,lm)*2.0**e
                    wk=sweep(part,wk,o,np.full(len(o),trelax or lastr),lam,per_pass=5)
                    m,mod=_misfit(judge,w,wk.array); mis.append(m); pw.append(e)
                    if m>min(mis)+2*ev*mod: break
                mis=np.array(mis); top=mis.min()+ev*mod; last=int(np.flatnonzero(mis<=top)[-1])
                e=pw[last]
                if last+1<len(pw): e+=(top-mis[last])/(mis[last+1]-mis[last])
                times["trial"]=time.perf_counter()-T; T=time.perf_counter()
            before=(level,level.whole(work.array))
        else:
            m2=error_of_model(level.A,level.whole(work.array.copy()) if False else work.array); ln,lm=lam_formula(level,m2,nl)
            lam=np.hypot(kn*ln,lm*2.0**e) if split else np.hypot(kn*ln,lm)*2.0**e
            for j in range(passes):
                sl=slice(j*len(A),(j+1)*len(A))
                work=sweep(level,work,order[sl],shares[sl] if not flat else np.full(len(A),flat),lam)
                if cb: cb(work.array)
            times["fine"]=time.perf_counter()-T
    return level.whole(work.array),e
if __name__=="__main__":
  tot={}
  for l in open(sys.argv[1]):
    r=json.loads(l)
    s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    best=min(q["err"] for q in r["rows"]) if "rows" in r else r["sart"][0]
    line=[f"{r['seed']} {r['family']:9s} n{r['n']} v{len(A)} b/sart {best/r['sart'][0]:.2f} fast/sart {r['fast']/r['sart'][0]:.2f}"]
    for name,kw in json.loads(sys.argv[2]).items():
        errs=[]
        x,e=run(A,p,s.photons,cb=lambda x: errs.append(s.error(x)/r['sart'][0]),**kw)
        line.append(f"| {name}: e {e:.1f} "+" ".join(f"{q:.2f}" for q in errs))
        tot.setdefault(name,[]).append(errs)
    print(" ".join(line),flush=True)
  for k,v in tot.items():
    v=np.array(v); print(k,"median",np.median(v,0).round(3),"p95",np.percentile(v,95,axis=0).round(3),"max",v.max(0).round(3))
