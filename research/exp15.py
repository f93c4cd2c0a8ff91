import sys; sys.path.insert(0,"/tmp/e60")
from exp9 import *
import twinct.recon.ordered_subsets as OS
tot={}
variants={"d5":dict(d=5,tol=.02),"d3":dict(d=3,tol=.02),"d5t3":dict(d=5,tol=.03)}
for f in sys.argv[1:]:
  for l in open(f):
    r=json.loads(l); s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    best=min(q["err"] for q in r["rows"]) if "rows" in r else np.nan
    line=f"{r['seed']} {r['family']:9s} n{r['n']} v{len(A)} sart@{r['sart'][1]} fast {r['fast']/r['sart'][0]:.2f} b {best/r['sart'][0]:.2f}"
    t=time.perf_counter(); sart(A,p,iterations=2,relaxation=1.0,nonnegative=True); tp=(time.perf_counter()-t)/2
    for k,v in variants.items():
        OS.DUAL_STEPS=v["d"]; errs=[]; tm={}
        x,rho=newfast(A,p,s.photons,passes=12,tol=v["tol"],times=tm,cb=lambda x: errs.append(s.error(x)/r['sart'][0]))
        T=sum(tm.values())/tp/max(5,r['sart'][1])
        line+=f" | {k} rho {np.log2(rho):.1f} @{len(errs)} {errs[-1]:.2f} t {T:.2f}"
        tot.setdefault(k,[]).append((errs[-1],T,len(errs)))
    print(line,{k:round(v/tp,2) for k,v in tm.items()},flush=True)
for k,v in tot.items():
    v=np.array(v); print(k,"err median %.3f p95 %.3f max %.2f"%(np.median(v[:,0]),np.percentile(v[:,0],95),v[:,0].max()),"t median %.2f p95 %.2f"%(np.median(v[:,1]),np.percentile(v[:,1],95)),"passes",np.median(v[:,2]))
